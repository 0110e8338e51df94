//! Records of other programs; the first line names the program.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_measure::compensation_export::linuxcnc::LinuxcncLinearUnit;
use rtec_measure::import::{self, ImportColumn, Sampling, TableSyntax, UserTableFormat};
use rtec_measure::run_record_files;
use rtec_model::record::{Axis, RunKind};
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let (file, to) = (Path::new(rtec_fuzz::NAME), Path::new("to.run.toml"));
    let axis = Axis::new("x").expect("a letter is an axis");
    let Some((which, data)) = data.iter().position(|b| *b == b'\n').map(|at| data.split_at(at + 1)) else {
        return;
    };
    let Some(text) = rtec_fuzz::checked(import::any_text(file, data)) else { return };
    let wanted = |named: &[&str]| {
        let columns = named.iter().map(|c| ImportColumn::parse(c).expect("a column as it is written"));
        columns.collect::<Vec<ImportColumn>>()
    };
    let read = match which {
        b"rtl\n" => import::rtl(file, &text, &axis, to),
        b"etalon\n" => import::etalon(file, &text, &axis, to),
        b"ecmc\n" => import::ecmc_dat(file, &text, &axis, to),
        b"cmm\n" => import::cmm_plate(file, &text, to),
        b"linuxcnc\n" => import::linuxcnc_comp(file, &text, &axis, false, LinuxcncLinearUnit::Mm, to),
        b"halsampler\n" => {
            let sampling = Sampling { period_s: 0.001, numbered: true };
            let wanted = wanted(&["1=position.x", "2=error.x:mm"]);
            import::halsampler(
                file,
                &text,
                &wanted,
                &sampling,
                &TableSyntax::default(),
                RunKind::Dynamics,
                to,
            )
        }
        b"shdr\n" => import::shdr(file, &text, &wanted(&["Xabs=position.x"]), RunKind::Drift, true, to),
        b"csv\n" => {
            let wanted = wanted(&["t=time", "e=error.x:mm"]);
            import::table(file, &text, &wanted, &TableSyntax::default(), RunKind::Drift, to)
        }
        b"own\n" => {
            let [form, table] = rtec_fuzz::parts(&text);
            let Some(own) = rtec_fuzz::checked(UserTableFormat::parse(file, form)) else { return };
            own.read(file, table, to)
        }
        _ => return,
    };
    let Some(mut read) = rtec_fuzz::checked(read) else { return };
    let path = rtec_fuzz::put("to.run.toml", b"");
    (read.path, read.file) = (path, "to.csv".to_owned());
    run_record_files::write(&mut read).expect("the folder can be written to");
    let again = run_record_files::read_log(&read.path).expect("what is written is read");
    assert_eq!(again.columns, read.columns);
    assert_eq!((again.note, again.kind), (read.note, read.kind));
});
