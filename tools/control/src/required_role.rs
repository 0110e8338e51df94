//! The role that each request needs.

use crate::protocol::ClientRequest;
use crate::role::Role;

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
