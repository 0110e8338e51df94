//! The Python interface of the libraries, without any logic of its own.
//! Every answer comes from the libraries. `python/rtec` gives it the form that a reader of Python expects.
//!
//! Each function returns documents as the text that `rtecctl … --json` prints, arrays as numpy's, and last
//! the messages. Rust works without the interpreter's lock.

mod border;
mod library_calls;
mod machine;
mod record;

use pyo3::prelude::*;

#[pymodule]
mod _rtec {
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        rtec_files::file_format_stamp::built_from(env!("RTEC_COMMIT"));
        module.add("__version__", rtec_files::file_format_stamp::VERSION)
    }

    #[pymodule_export]
    use super::library_calls::{
        designs, evaluate, example, export_table, fit, fit_chain, fit_named, history, import_record,
        part_errors, plan, prediction_picture, reconcile, regression, replay, simulate, validate,
        where_they_disagree,
    };
    #[pymodule_export]
    use super::machine::Machine;
    #[pymodule_export]
    use super::record::Record;
}
