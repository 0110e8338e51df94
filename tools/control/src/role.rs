//! Roles: a connection may request what the role of its socket allows.
//!
//! | role | may | socket |
//! |---|---|---|
//! | [`Role::View`] | see: `status`, `watch`, `explain`, `observe`, `ledger`, `whoami` | `control-view.sock` |
//! | [`Role::Operate`] | the same, and `home`, `enable`, `disable`, `shadow`, `probe`, `hold`, `jog` (a simulated axis), `keep`, `model_again` | `control-operate.sock` |
//! | [`Role::SetUp`] | everything: also `correct`, `clear`, models and part tables | `control.sock`, as `[control] socket` has it |

use crate::protocol::ClientRequest;
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

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.word().replace('_', " "))
    }
}

impl ClientRequest {
    /// The lowest role that may make this request.
    pub const fn needs(&self) -> Role {
        match self {
            Self::Status {}
            | Self::Watch {}
            | Self::Explain { .. }
            | Self::Observe { .. }
            | Self::Ledger { .. }
            | Self::Whoami {} => Role::View,
            Self::Home { .. }
            | Self::Enable { .. }
            | Self::Disable {}
            | Self::Park {}
            | Self::Shadow {}
            | Self::Probe { .. }
            | Self::Hold { .. }
            | Self::Jog { .. }
            | Self::ModelAgain {}
            | Self::Keep { .. } => Role::Operate,
            Self::Correct { .. }
            | Self::Clear {}
            | Self::ModelLoad { .. }
            | Self::ModelUnload {}
            | Self::TableLoad(_)
            | Self::TableUnload {} => Role::SetUp,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The documented list and the applied rule agree.
    #[test]
    fn what_a_role_may_is_what_it_needs() {
        let fields = r#""axis":"x","total_counts":1,"on":true,"errors":"e","axes":["z","x"],"centre_mm":[0,0],
                        "radius_mm":1,"nose_mm":1,"origin_mm":[0,0],"lead_ms":1"#;
        let all = Role::SetUp.may();
        for name in &all {
            // The first subset of fields that this request accepts.
            let takes = |keys: &[&str]| {
                let given: serde_json::Map<String, serde_json::Value> =
                    serde_json::from_str(&format!("{{{fields}}}")).unwrap();
                let mut map: serde_json::Map<String, serde_json::Value> =
                    given.into_iter().filter(|(k, _)| keys.contains(&k.as_str())).collect();
                map.insert("do".into(), (*name).into());
                ClientRequest::parse(&serde_json::Value::Object(map).to_string()).ok()
            };
            let table =
                ["errors", "axes", "centre_mm", "radius_mm", "nose_mm", "origin_mm", "lead_ms"].as_slice();
            let request = [&[][..], &["axis"], &["axis", "total_counts"], &["on"], table]
                .into_iter()
                .find_map(takes)
                .unwrap_or_else(|| panic!("{name}"));
            let needed = request.needs();
            for role in Role::ALL {
                assert_eq!(role.may().contains(name), needed <= role, "{name} {role}");
            }
        }
    }
}
