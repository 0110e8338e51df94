//! Names in a configuration that this computer lacks.

use super::*;

#[test]
fn what_this_computer_lacks_is_found_on_it_and_nowhere_else() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("rtec.toml");
    let text = CONTRACT
        .replace("file = \"regs\"", "uio = \"/dev/null-and-void\"")
        .replace("group = \"rtec\"", "group = \"nobody-has-this\"\nview = { group = \"nor-this\" }");
    std::fs::write(&file, format!("{text}[model]\nfile = \"missing.toml\"\n")).unwrap();
    assert!(Config::load(&file).is_ok());
    let found = Config::check_here(&file).unwrap_err().to_string();
    for wants in ["/dev/null-and-void", "nobody-has-this", "nor-this", "missing.toml"] {
        assert!(found.contains(wants), "no {wants} in {found}");
    }
    // One more finding on a computer with fewer than four CPUs.
    let cpus = usize::from(found.contains("cpu = 3"));
    let findings = found.lines().filter(|line| !line.starts_with("note: "));
    assert_eq!(findings.count(), 4 + cpus, "{found}");
}

/// The commonest mistakes are found.
/// They are a wrong record or column name, a model of missing sensors, and a card in another computer. A sensor may
/// be plugged in later.
#[test]
fn what_sensors_model_and_card_name_is_looked_for() {
    let directory = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &str| std::fs::write(directory.path().join(name), text).unwrap();
    let file = directory.path().join("rtec.toml");
    let check = |more: &str| {
        put("rtec.toml", &format!("{EMBEDDED}\n{more}"));
        Config::check_here(&file).map(|c| c.notes).map_err(|e| e.to_string())
    };
    let usual = check("").unwrap();
    put(
        "day.run.toml",
        "file = \"day.csv\"\nkind = \"drift\"\n[columns]\nT1 = { role = \"temperature\", unit = \"degC\" }\n",
    );
    put("day.csv", "T1\n20\n21\n");
    let replayed = |record: &str, column: &str| {
        format!("[[sensor]]\nname = \"T1\"\nsource = \"csv\"\nrecord = \"{record}\"\ncolumn = \"{column}\"\n")
    };
    assert_eq!(check(&replayed("day.run.toml", "T1")), Ok(usual.clone()));
    let found = check(&replayed("night.run.toml", "T1")).unwrap_err();
    assert!(found.contains("night.run.toml") && found.lines().count() == 1, "{found}");
    let found = check(&replayed("day.run.toml", "T9")).unwrap_err();
    assert!(
        found.contains("found column 'T9', expected a column of") && found.ends_with("day.run.toml: T1"),
        "{found}"
    );

    let notes =
        check("[[sensor]]\nname = \"T1\"\nsource = \"one_wire\"\nid = \"28-0123456789ab\"\n").unwrap();
    assert!(
        notes.len() == usual.len() + 1
            && notes.last().unwrap().contains("[[sensor]] T1: nothing is read from it now"),
        "{notes:?}"
    );

    put(
        "machine.toml",
        "name = \"m\"\n[[effect]]\nname = \"thermal_growth.x\"\nsensor = \"T7\"\nreference_degC = 20.0\num_per_K = 2.0\n",
    );
    let found = check("[model]\nfile = \"machine.toml\"\n").unwrap_err();
    assert!(found.contains("T7 (read by thermal_growth.x)"), "{found}");
    put("machine.toml", "name = \"m\"\n[[effect]]\nname = \"scale.w\"\nppm = 2.0\n");
    let notes = check("[model]\nfile = \"machine.toml\"\n").unwrap();
    assert!(
        notes.last().unwrap().starts_with("[model] no axis w in the daemon's configuration"),
        "{notes:?}"
    );

    let card =
        CONTRACT.replace("file = \"regs\"", "pci = \"dead:beef\"\nbar = 0").replace("group = \"rtec\"", "");
    std::fs::write(&file, &card).unwrap();
    let found = Config::check_here(&file).unwrap_err().to_string();
    assert!(found.contains("no PCI card dead:beef"), "{found}");
    assert!(Config::load(&file).is_ok());
}

/// Names that this computer lacks are reported with their lines.
/// They are a chip, a CPU, a group and a file.
#[test]
fn names_what_this_computer_does_not_have() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("rtec.toml");
    let field = "[machine]\nname = \"pi lathe\"\n[card]\nbackend = \"gpio\"\nchip = \"gpiochip77\"\n[[axis]]\nname = \"x\"\n\
        count_um = 1.0\ntravel_mm = 400\nmax_correction_counts = 1000\nwindow_counts = 50\nmin_separation_ns = 500\n\
        max_accel_mm_s2 = 1000.0\nlines = { a = 0, b = 1, invert_a = 2, invert_b = 3 }\n[rt]\ncpu = 4000\ndetect_ns = 5000\n\
        write_ns = 1000\n[control]\ngroup = \"no-such-group\"\n";
    let mapped = CONTRACT.replace("group = \"rtec\"\n", "");
    let parport = mapped.replace(
        "backend = \"mapped\"\nfile = \"regs\"\nprobe = 28",
        "backend = \"port\"\nparport = \"none\"",
    );
    let lines = "lines = { a = 3, b = 4, invert_a = 0, invert_b = 1 }\n[rt]";
    let parport = parport.replace("write_ns = 300", "write_ns = 1000").replace("lines = { a = \"in4\", b = 5, invert_a = \"out2\", invert_b = \"out3\", read_back_a = 6, read_back_b = 7 }\n[rt]", lines);
    for (text, says) in [
        (field, &["5:", "gpiochip77", "cpu = 4000", "no-such-group", "--elsewhere"][1..]),
        (&mapped, &["\"regs\", which cannot be looked at: No such file"][..]),
        (&parport, &["\"none\", which cannot be looked at: No such file"][..]),
    ] {
        std::fs::write(&file, text).unwrap();
        assert!(Config::load(&file).is_ok(), "{}", Config::load(&file).unwrap_err());
        let found = Config::check_here(&file).unwrap_err().to_string();
        for text in says {
            assert!(found.contains(text), "no {text} in {found}");
        }
        // Four lines on one absent chip are one finding.
        assert!(found.matches("gpiochip77").count() <= 1, "{found}");
    }
}

/// A name that this computer lacks is a finding of `config check`.
#[test]
fn check_here_names_what_this_computer_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("rtec.toml");
    let axis = |rest: &str| {
        format!(
            "[[axis]]\nname = 'x'\ncount_um = 1.0\ntravel_mm = 400\nmax_correction_counts = 1000\nwindow_counts = 50\n\
             min_separation_ns = 500\nmax_accel_mm_s2 = 1000.0\n{rest}\n"
        )
    };
    let lines = "lines = { a = 0, b = 1, invert_a = 2, invert_b = 3 }";
    let memory = "lines = { a = 'in0', b = 'in1', invert_a = 'out0', invert_b = 'out1' }";
    let port = "lines = { a = 'nack', b = 'busy', invert_a = 'd0', invert_b = 'd1' }";
    let mock = |rest: &str| format!("[card]\nbackend = 'mock'\n{}{rest}", axis(""));
    let mapped =
        |key: &str| format!("[card]\nbackend = 'mapped'\nprofile = 'shared-memory'\n{key}\n{}", axis(memory));
    let replayed =
        |name: &str| format!("[[sensor]]\nname = 'T1'\nsource = 'csv'\nrecord = '{name}.run.toml'\n");
    let sidecar = |name: &str| {
        format!(
            "file = \"{name}.csv\"\nkind = \"drift\"\n[columns]\nt = {{ role = \"time\", unit = \"s\" }}\n\
             T1 = {{ role = \"temperature\", unit = \"degC\" }}\n"
        )
    };
    let folder = file.parent().unwrap();
    for (name, csv) in [
        ("beside", None),
        ("document", Some("%PDF-1.7\n%\u{e2}\n")),
        ("absolute", Some("t,T1\n2026-01-02T03:04:05,20\n2026-01-02T03:05:05,21\n")),
    ] {
        std::fs::write(folder.join(format!("{name}.run.toml")), sidecar(name)).unwrap();
        if let Some(csv) = csv {
            std::fs::write(folder.join(format!("{name}.csv")), csv).unwrap();
        }
    }
    for (name, says, config) in [
        (
            "chip",
            "GPIO chip gpiochip4095",
            format!("[card]\nbackend = 'gpio'\nchip = 'gpiochip4095'\n{}", axis(lines)),
        ),
        ("file", "/nonexistent/registers", mapped("file = '/nonexistent/registers'")),
        ("uio", "/dev/uio4095", mapped("uio = '/dev/uio4095'")),
        ("pci", "PCI card fffe:fffe", mapped("pci = 'fffe:fffe'")),
        (
            "parport",
            "/dev/parport4095",
            format!(
                "[card]\nbackend = 'port'\nprofile = 'parallel-port'\nparport = '/dev/parport4095'\n{}",
                axis(port)
            ),
        ),
        ("profile", "gone.toml", mapped("file = '/dev/null'").replace("'shared-memory'", "'gone.toml'")),
        ("trace", "gone.csv", format!("[card]\nbackend = 'replay'\n{}", axis("trace = 'gone.csv'"))),
        ("cpu", "cpu = 4095", mock("[rt]\ncpu = 4095\n")),
        ("group", "nosuchgroup-rtec", mock("[control]\ngroup = 'nosuchgroup-rtec'\n")),
        ("log folder", "/nonexistent", mock("[control]\nlog_file = '/nonexistent/log'\n")),
        ("model", "gone.machine.toml", mock("[model]\nfile = 'gone.machine.toml'\n")),
        (
            "recording",
            "gone.run.toml",
            mock("[[sensor]]\nname = 'T1'\nsource = 'csv'\nrecord = 'gone.run.toml'\n"),
        ),
        ("csv beside it", "beside.csv", mock(&replayed("beside"))),
        ("recording as PDF", "a PDF document", mock(&replayed("document"))),
        ("absolute times", "2026-01-02T03:04:05", mock(&replayed("absolute"))),
    ] {
        let text = format!("[machine]\nname = 'm'\n{config}");
        std::fs::write(&file, &text).unwrap();
        let found = Config::check_here(&file).expect_err(name).to_string();
        assert!(found.contains(says) && found.contains("rtec.toml:"), "{name}: {found}");
        // For another computer these are not checked; profiles are part of the configuration.
        if name != "profile" {
            let elsewhere = Config::load(&file).map_err(|e| e.to_string());
            assert!(elsewhere.is_ok(), "{name}: {elsewhere:?}");
        }
    }
    // Notes are given together with findings.
    let silent = "[[sensor]]\nname = 'T2'\nsource = 'one_wire'\nid = '28-000000000000'\n";
    std::fs::write(&file, format!("[machine]\nname = 'm'\n{}", mock(&(replayed("beside") + silent))))
        .unwrap();
    let both = Config::check_here(&file).unwrap_err();
    assert!(both.1[0].contains("[[sensor]] T2") && both.to_string().contains("note: "), "{both}");
    // A device that may be connected later is a note.
    std::fs::write(&file, format!("[machine]\nname = 'm'\n{}", mock("[[sensor]]\nname = 'T1'\nsource = 'one_wire'\nid = '28-000000000000'\n[control]\nspool = '/nonexistent/spool'\n"))).unwrap();
    let notes = Config::check_here(&file).unwrap().notes.join("\n");
    assert!(notes.contains("[[sensor]] T1") && notes.contains("/nonexistent/spool"), "{notes}");
}
