//! Every key of `rtec.toml`: these tables read, check and show it.

use rtec_files::keys;
use rtec_files::toml_section_keys::AcceptedKeyValue::{
    self, Choice, Flag, Line, Name, Number, Own, Text, Whole, Word,
};
use rtec_files::toml_section_keys::{REQUIRED, TomlKeySpec, markdown};

keys! {
    /// `[machine]`.
    pub(super) MACHINE:
    name: Name, "", REQUIRED, "the machine's name, as status and metrics show it";
    mtc_off: Choice(&["freeze", "hold"]), "", "`freeze`", "when `mtc_ready` falls: freeze the corrections, or hold the feed too";
}

const LINE: AcceptedKeyValue = AcceptedKeyValue::Own("a line's name or bit");

keys! {
    /// `[card]`; the keys that apply depend on the backend.
    pub(super) CARD:
    backend: Choice(&["mock", "gpio", "mapped", "port", "replay"]), "", REQUIRED, "simulated axes, GPIO lines, registers in memory, I/O ports or recorded traces";
    file: Text, "", "none", "`mapped`: the path of the file of registers; `uio` or `pci` instead";
    uio: Text, "", "none", "`mapped`: a UIO device, as `/dev/uio0`";
    map: Whole(0, 4), "", "0", "which map of the `uio` device";
    pci: Text, "", "the profile's", "`mapped`, `port`: a card as `1af4:1110`, or its address `0000:00:04.0`";
    bar: Whole(0, 5), "", "the profile's", "which base address register of the `pci` card";
    parport: Text, "", "none", "`port`: a parallel port, as `/dev/parport0`; `io` or `pci` instead";
    io: Whole(0, 0xffff), "", "none", "`port`: the address of the first I/O port, as `0x378`";
    profile: Text, "", "`shared-memory`; `parallel-port`", "`mapped`, `port`: what each register and bit means: a name of `rtecctl card list`, or a file";
    mode: Choice(&["edges", "levels"]), "", "`edges`", "`gpio`: sleep until an edge comes, or read the levels without pause";
    chip: Text, "", "none", "`gpio`: the chip of lines that name none: a name, path or label, as `gpiochip0`";
    bias: Choice(&["pull-up", "pull-down", "disabled"]), "", "as it is", "`gpio`: of lines that do not say otherwise";
    drive: Choice(&["push-pull", "open-drain", "open-source"]), "", "`push-pull`", "`gpio`: of lines that do not say otherwise";
    probe: LINE, "", "not wired", "the probe's line";
    disable: LINE, "", "not wired", "the line of the disable switch";
    mtc_ready: LINE, "", "not wired", "the line that tells that the MTC is on and counts";
    hold: LINE, "", "not wired", "the line of feed hold";
}

const COUNTS: AcceptedKeyValue = AcceptedKeyValue::Whole(1, 1_000_000_000);

keys! {
    /// `[[axis]]`.
    pub(super) AXIS:
    name: Word, "", REQUIRED, "the axis's name";
    count_um: Number(1e-4, 1000.0), "µm", REQUIRED, "what one count (a quadrature state) is worth";
    travel_mm: Number(1e-3, 1e6), "mm", REQUIRED, "the length of its travel";
    max_correction_counts: COUNTS, "counts", REQUIRED, "the largest total correction";
    window_counts: COUNTS, "counts", "12 µm, at least one insertion", "largest change that is believed at once. Three corrections of 4 µm in NISTIR 4832; more where the model's own largest step (a reversal, coolant) is larger";
    min_separation_ns: COUNTS, "ns", REQUIRED, "what the MTC's decoder needs between two edges";
    max_accel_mm_s2: Number(1e-3, 1e9), "mm/s²", "required on a real card", "the acceleration limit, on which the speed gate rests";
    max_accel_counts_s2: Number(1e-3, 1e15), "counts/s²", "1e6 (mock, replay)", "the same in counts";
    rapid_mm_min: Number(1e-3, 1e6), "mm/min", "none; required to arm a real card", "the axis's rapid: corrections are not enabled where the card cannot follow it";
    hysteresis_counts: Number(1e-3, 1000.0), "counts", "0.05", "how far an axis goes back before an edge comes again";
    warn_counts: COUNTS, "counts", "none", "a request beyond it is an event";
    error_counts: COUNTS, "counts", "none", "a request beyond it is a fault (`error_limit`) and holds";
    max_rate_counts_s: Number(1e-3, 1e9), "counts/s", "no limit", "how fast a total may be followed";
    rest_policy: Choice(&["wait", "insert"]), "", "`wait`", "at rest: wait for an edge, or insert after `rest_quiet_ms` without one";
    rest_quiet_ms: Number(1e-3, 1e6), "ms", "none", "the quiet time of `insert`. It should be longer than an axis takes over a count at its slowest turn: 2·√(2/a), a in counts/s². A circle of 150 mm at 250 mm/min takes 300 ms. Otherwise an edge may meet the insertion, and `config check` says so";
    reference_budget_counts: COUNTS, "counts", "none", "what the MTC tolerates between reference marks or encoders: caps `max_correction_counts`";
    home_mm: Number(-1e6, 1e6), "mm", "0", "position of the known place where it is homed";
    trace: Text, "", "none", "`replay`: the recorded trace of this axis, .csv or .vcd";
    simulated: Own("a table, below"), "", "as configured", "`mock`: a simulated machine that is not as configured";
    lines: Own("a table, below"), "", "required on a real card", "where its scale and inverters are wired";
}

keys! {
    /// `lines` of an axis.
    pub(super) LINES:
    a: LINE, "", REQUIRED, "the scale's A";
    b: LINE, "", REQUIRED, "the scale's B";
    invert_a: LINE, "", REQUIRED, "the output that inverts A";
    invert_b: LINE, "", REQUIRED, "the output that inverts B";
    read_back_a: LINE, "", "not wired", "A' as it comes back from the gate";
    read_back_b: LINE, "", "not wired", "B' as it comes back from the gate";
}

keys! {
    /// `simulated` of an axis.
    pub(super) SIMULATED:
    count_um: Own("±0.0001 to ±1000"), "µm", "as configured", "what a count is really worth; negative where it counts backwards";
    compensates_ppm: Number(-1e5, 1e5), "ppm", "0", "what its controller compensates by itself";
    feedback: Choice(&["used", "ignored"]), "", "`used`", "whether its controller uses the feedback that it is sent";
}

const NS: AcceptedKeyValue = AcceptedKeyValue::Whole(0, 1_000_000_000);

keys! {
    /// `[rt]`.
    pub(super) RT:
    cpu: Whole(0, 4095), "", "an isolated CPU, else the last", "the CPU of the real-time thread";
    priority: Whole(1, 99), "", "80", "its `SCHED_FIFO` priority";
    detect_ns: NS, "ns", "0 (mock, replay)", "as `rtecctl selftest latency` has measured it; a real card is not armed without";
    write_ns: NS, "ns", "0 (mock, replay)", "as `detect_ns`";
    guard_ns: NS, "ns", "0", "kept free before the next edge, on top";
    measured: Own("a table, below"), "", "none", "where and when they were measured, as the self-test prints it. A real card needs figures of this card, kernel and CPU, at most a year old";
}

keys! {
    /// `measured` of `[rt]`.
    pub(super) MEASURED:
    card: Line, "", REQUIRED, "the card that was measured with";
    kernel: Line, "", REQUIRED, "the kernel's release";
    cpu: Line, "", REQUIRED, "the processor";
    date: Line, "", REQUIRED, "the day, as `2026-11-26`";
}

keys! {
    /// `operate` and `view` of `[control]`.
    pub(super) SOCKET:
    socket: Text, "", "beside the other, with `-operate` or `-view` in its name", "the path of the socket";
    group: Word, "", "only the daemon's user", "the group that may use the socket";
    mode: Own("`\"0600\"`, `\"0660\"`, `\"0666\"`"), "", "`0660` with a group, else `0600`", "the socket's mode";
}

keys! {
    /// `[control]`.
    pub(super) CONTROL:
    socket: Text, "", "`control.sock` in the directory that `RTEC_RUN_DIR` names, else in `/run/rtec` or the user's run-time directory", "the path of the socket";
    group: Word, "", "only the daemon's user", "the group that may use the socket";
    mode: Own("`\"0600\"`, `\"0660\"`, `\"0666\"`"), "", "`0660` with a group, else `0600`", "the socket's mode";
    operate: Own("a table, below"), "", "only the daemon's user", "the socket to operate";
    view: Own("a table, below"), "", "only the daemon's user", "the socket to see";
    state_file: Text, "", "`state` beside the socket", "what a restart takes over (real cards)";
    log_file: Text, "", "`/var/log/rtec/audit.log` of an installed daemon, else beside the state file", "the record of every command";
    log_anchor: Flag, "", "`false`", "whether the number and hash of the record's last line go to the system's journal: at the start, with each full file, once a day";
    spool: Text, "", "none", "the folder for finished records, for `rtecctl ship`: probing runs, and what `characterise record --spool` hands over; it must be there and writable for the daemon";
    spool_mb: Whole(1, 1_048_576), "MB", "1024", "what may wait there at most; beyond it, and where less is free than this and than 5 % of the disk, a record is not kept";
    stale_ms: Whole(10, 60_000), "ms", "500", "silence of the control side after which corrections are switched off";
}

keys! {
    /// `[model]`.
    pub(super) MODEL:
    file: Text, "", "none", "the path of the machine model; it runs once `rtecctl model load` has taken it";
    period_ms: Whole(10, 20), "ms", "10", "time between two evaluations";
    ramp_um_s: Number(1e-3, 1000.0), "µm/s", "5", "rate limit of correction changes that are not caused by motion";
    lead_ms: Number(1e-3, 1000.0), "ms", "0", "look-ahead time of the evaluation: one `period_ms` and the lag of the position loop";
    log_s: Number(0.05, 60.0), "s", "5", "time between two logged sets of temperatures";
}

/// The tables of the reference page, in its order.
pub fn reference() -> String {
    let sections: [(&str, &[TomlKeySpec]); 11] = [
        ("[machine]", MACHINE),
        ("[card]", CARD),
        ("[[axis]]", AXIS),
        ("lines", LINES),
        ("simulated", SIMULATED),
        ("[rt]", RT),
        ("measured", MEASURED),
        ("[control]", CONTROL),
        ("operate, view", SOCKET),
        ("[model]", MODEL),
        ("[[sensor]]", rtec_sensors::KEYS),
    ];
    let tables = sections.map(|(title, keys)| markdown(title, keys));
    tables.join("\n")
}
