//! `rtecctl model …`: reads, fits, judges and shows machine models.

mod chain;
mod export;
mod fit;
mod load;
mod predict;
mod show;
mod validate;

super::verbs_below! {
    /// Work with machine models: choose sensors, fit, predict, judge, rehearse, load, show, compare, export
    Args;
    /// Take the model up again that was unloaded last, as it was read when it was loaded
    Again crate::daemon_connection::DaemonArgs => load::again;
    Compare show::CompareArgs => show::compare;
    Export export::Args => export::run;
    Fit fit::FitArgs => fit::run;
    FitChain chain::Args => chain::run;
    Load load::LoadArgs => load::load;
    Predict predict::Args => predict::run;
    Rehearse validate::RehearseArgs => validate::rehearse;
    SelectSensors fit::SelectSensorsArgs => fit::select;
    Show show::ShowArgs => show::show;
    /// Run without a model: corrections go back in a ramp
    Unload crate::daemon_connection::DaemonArgs => load::unload;
    Validate validate::ValidateArgs => validate::validate;
}
