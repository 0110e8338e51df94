//! Roles: a connection may request what the role of its socket allows.
//!
//! | role | may | socket |
//! |---|---|---|
//! | [`ClientRole::View`] | see: `status`, `watch`, `explain`, `observe`, `ledger`, `whoami` | `control-view.sock` |
//! | [`ClientRole::Operate`] | the same, and `home`, `enable`, `disable`, `shadow`, `probe`, `hold`, `jog` (a simulated axis), `keep`, `model_again` | `control-operate.sock` |
//! | [`ClientRole::SetUp`] | everything: also `correct`, `clear`, models and part tables | `control.sock`, as `[control] socket` has it |

use serde::{Deserialize, Serialize};
use std::fmt;

/// What a connection may request; each role includes those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClientRole {
    /// See the state.
    View,
    /// Run the machine as it is set up.
    Operate,
    /// Set it up.
    SetUp,
}

impl ClientRole {
    /// All roles, the lowest first.
    pub const ALL: [Self; 3] = [Self::View, Self::Operate, Self::SetUp];

    /// The requests for which each role is needed, as the protocol names them.
    const REQUESTS: [(Self, &'static str); 3] = [
        (Self::View, "status watch explain observe ledger whoami"),
        (Self::Operate, "home enable disable park shadow probe hold jog keep model_again"),
        (Self::SetUp, "correct clear model_load model_unload table_load table_unload"),
    ];

    /// As the protocol writes it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Operate => "operate",
            Self::SetUp => "set_up",
        }
    }

    /// The requests that this role may make.
    pub fn may(self) -> Vec<&'static str> {
        let allowed = Self::REQUESTS.into_iter().filter(|(needed, _)| *needed <= self);
        allowed.flat_map(|(_, names)| names.split(' ')).collect()
    }
}

impl fmt::Display for ClientRole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.word().replace('_', " "))
    }
}
