//! Roles: a connection may request what the role of its socket allows.
//!
//! | role | may | socket |
//! |---|---|---|
//! | [`Role::View`] | see: `status`, `watch`, `explain`, `observe`, `ledger`, `whoami` | `control-view.sock` |
//! | [`Role::Operate`] | the same, and `home`, `enable`, `disable`, `shadow`, `probe`, `hold`, `jog` (a simulated axis), `keep`, `model_again` | `control-operate.sock` |
//! | [`Role::SetUp`] | everything: also `correct`, `clear`, models and part tables | `control.sock`, as `[control] socket` has it |

use serde::{Deserialize, Serialize};
use std::fmt;

/// What a connection may request; each role includes those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// See the state.
    View,
    /// Run the machine as it is set up.
    Operate,
    /// Set it up.
    SetUp,
}

impl Role {
    /// All roles, the lowest first.
    pub const ALL: [Self; 3] = [Self::View, Self::Operate, Self::SetUp];

    /// As the protocol writes it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Operate => "operate",
            Self::SetUp => "set_up",
        }
    }

    /// The requests that this role may make, as the protocol names them.
    pub fn may(self) -> Vec<&'static str> {
        let all = [
            ("status", Self::View),
            ("watch", Self::View),
            ("explain", Self::View),
            ("observe", Self::View),
            ("ledger", Self::View),
            ("whoami", Self::View),
            ("home", Self::Operate),
            ("enable", Self::Operate),
            ("disable", Self::Operate),
            ("park", Self::Operate),
            ("shadow", Self::Operate),
            ("probe", Self::Operate),
            ("hold", Self::Operate),
            ("jog", Self::Operate),
            ("keep", Self::Operate),
            ("model_again", Self::Operate),
            ("correct", Self::SetUp),
            ("clear", Self::SetUp),
            ("model_load", Self::SetUp),
            ("model_unload", Self::SetUp),
            ("table_load", Self::SetUp),
            ("table_unload", Self::SetUp),
        ];
        all.into_iter().filter(|(_, needs)| *needs <= self).map(|(name, _)| name).collect()
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.word().replace('_', " "))
    }
}
