//! Value change dumps (IEEE 1364) with the signals a and b.
//! Simulators and logic analysers write them.

use crate::input_error::InputError;
use crate::line_reader::LineReader;
use crate::message_text::quoted;
use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::TracePoint;
use std::fmt::Write as _;
use std::io::Read;

/// The levels of a one-bit signal.
/// They are those of IEEE 1364, and the nine of VHDL (IEEE 1164), of which H and L are driven weakly.
const LEVELS: &[u8] = b"01xXzZuUwWhHlL-";

/// Number of variables that a message lists if a or b is not among them.
const MOST_NAMED: usize = 16;

/// The definitions of a VCD, and the state of reading its changes.
#[derive(Debug)]
pub(crate) struct VcdReader {
    /// ns per time unit as a fraction: 1 µs is (1000, 1), 100 ps is (1, 10).
    ns_per_unit: (u64, u64),
    /// Identifier codes of a and b.
    codes: [Vec<u8>; 2],
    /// Present time in units.
    now: u64,
    levels: [Option<bool>; 2],
    /// Whether a level was written since `now`.
    touched: bool,
    /// Signals whose level is unknown, and the time up to which one was.
    unknown: [bool; 2],
    unknown_until: Option<u64>,
}

impl VcdReader {
    /// Reads the definitions.
    /// `names` are the names of a and b if they have others, or their numbers from 1 among the one-bit
    /// signals. A name may begin with its scopes, as `axis.a`.
    pub(crate) fn definitions<R: Read>(
        input: &mut LineReader<R>,
        names: [Option<&str>; 2],
    ) -> Result<Self, InputError> {
        input.line = 1;
        let (mut ns_per_unit, mut codes, mut others) = (None, [None, None], Vec::new());
        let mut scopes: Vec<String> = Vec::new();
        // One-bit signals so far.
        let mut bits = 0_usize;
        loop {
            let Some(keyword) = word(input)? else {
                return Err(input.at_word("the end of the file", "$enddefinitions"));
            };
            match keyword.as_str() {
                "$enddefinitions" => {
                    skip_to_end(input)?;
                    break;
                }
                "$timescale" => {
                    let text = until_end(input)?.concat();
                    ns_per_unit = Some(timescale(input, &text)?);
                }
                "$var" => {
                    let body = until_end(input)?;
                    if let [_, size, _, name, ..] = body.as_slice()
                        && size == "1"
                    {
                        bits += 1;
                        if others.len() < MOST_NAMED {
                            others.push(name.clone());
                        }
                    }
                    variable(input, &body, names, bits, &scopes, &mut codes)?;
                }
                "$scope" => scopes.push(until_end(input)?.pop().unwrap_or_default()),
                "$upscope" => {
                    scopes.pop();
                    skip_to_end(input)?;
                }
                "$comment" | "$date" | "$version" => skip_to_end(input)?,
                other => {
                    let expected = "a VCD definition: $timescale, $scope, $var, $upscope, $enddefinitions";
                    return Err(input.at_word(&quoted(other), expected));
                }
            }
        }
        let Some(ns_per_unit) = ns_per_unit else {
            return Err(input.at_word("no $timescale", "for example $timescale 1 ns $end"));
        };
        let [Some((a, _)), Some((b, _))] = codes else {
            let signal = usize::from(codes[0].is_some());
            let missing = names[signal].unwrap_or(["a", "b"][signal]);
            let mut expected = "two variables of one bit named a and b".to_owned();
            others.retain(|name| !matches!(name.as_str(), "a" | "A" | "b" | "B"));
            if !others.is_empty() {
                let _ = write!(expected, ", or --columns a=NAME,b=NAME with two of {}", others.join(", "));
            }
            return Err(input.at_word(&format!("no variable named {missing}"), &expected));
        };
        if a == b {
            let found = format!("a and b as one variable, {}", quoted(&String::from_utf8_lossy(&a)));
            return Err(input.at_word(&found, "two variables: a and b of one scale never change together"));
        }
        let (levels, unknown) = ([None; 2], [false; 2]);
        Ok(Self { ns_per_unit, codes: [a, b], now: 0, levels, touched: false, unknown, unknown_until: None })
    }

    /// Reads to the end of the next time step in which a or b changed.
    pub(crate) fn next<R: Read>(
        &mut self,
        input: &mut LineReader<R>,
        last: Option<TracePoint>,
    ) -> Result<Option<TracePoint>, InputError> {
        loop {
            let Some(range) = input.word()? else { return self.step(input, last) };
            let word = input.bytes(range);
            match word[0] {
                b'#' => {
                    let text = std::str::from_utf8(&word[1..]).unwrap_or_default();
                    let Ok(time) = text.parse::<u64>() else {
                        return Err(odd(input, word, "a time in whole units, as #1000"));
                    };
                    if time < self.now {
                        let expected = format!("a time not before #{}", self.now);
                        return Err(input.at_word(&format!("#{time}"), &expected));
                    }
                    let step = if time > self.now { self.step(input, last)? } else { None };
                    self.now = time;
                    if step.is_some() {
                        return Ok(step);
                    }
                }
                value if LEVELS.contains(&value) => {
                    if let Some(signal) = self.codes.iter().position(|code| *code == word[1..]) {
                        self.set(input, signal, value)?;
                    }
                }
                // A one-bit vector is written `b1 !`; only its last bit counts.
                b'b' | b'B' | b'r' | b'R' | b's' | b'S' => {
                    let (kind, value) = (word[0], word[word.len() - 1]);
                    let Some(code) = input.word()? else {
                        return Err(input.at_word("the end of the file", "the identifier of a value"));
                    };
                    let signal =
                        self.codes.iter().position(|own| own.as_slice() == input.bytes(code.clone()));
                    if let Some(signal) = signal {
                        if !kind.eq_ignore_ascii_case(&b'b') {
                            let expected = "a level 0 or 1 of a and b";
                            return Err(input.at_word("a real number or a string", expected));
                        }
                        self.set(input, signal, value)?;
                    }
                }
                b'$' => match word {
                    b"$comment" => skip_to_end(input)?,
                    b"$dumpvars" | b"$dumpall" | b"$dumpon" | b"$dumpoff" | b"$end" => {}
                    _ => return Err(odd(input, word, "$dumpvars, $dumpall, $dumpon, $dumpoff or $comment")),
                },
                _ => return Err(odd(input, word, "a time (#1000) or a value change (1!)")),
            }
        }
    }

    fn set<R: Read>(&mut self, input: &LineReader<R>, signal: usize, value: u8) -> Result<(), InputError> {
        self.touched = true;
        self.levels[signal] = match value {
            b'0' | b'L' | b'l' => Some(false),
            b'1' | b'H' | b'h' => Some(true),
            // Before the first level no change can be lost.
            _ if self.levels[signal].is_none() => {
                self.unknown[signal] = true;
                None
            }
            other => {
                let found = format!("{} for signal {}", char::from(other), ["a", "b"][signal]);
                return Err(
                    input.at_word(&found, "the level 0 or 1: unknown and open lines cannot be counted")
                );
            }
        };
        Ok(())
    }

    /// A note if a level was unknown at first, and until when.
    pub(crate) fn unknown_level_note(&self) -> Option<String> {
        let names: Vec<&str> =
            ["a", "b"].into_iter().zip(self.unknown).filter(|(_, is)| *is).map(|(name, _)| name).collect();
        let until = self.unknown_until?;
        Some(format!(
            "the level of {} is unknown before #{until}: no change before it counts",
            names.join(" and ")
        ))
    }

    /// The point of the present time step, if a or b changed in it.
    fn step<R: Read>(
        &mut self,
        input: &LineReader<R>,
        last: Option<TracePoint>,
    ) -> Result<Option<TracePoint>, InputError> {
        if !std::mem::take(&mut self.touched) {
            return Ok(None);
        }
        let [Some(a), Some(b)] = self.levels else {
            if (0..2).all(|n| self.levels[n].is_some() || self.unknown[n]) {
                return Ok(None);
            }
            let missing = if self.levels[0].is_none() { "a" } else { "b" };
            let found = format!("no value of {missing} at #{}", self.now);
            return Err(input.at_word(&found, "a value of a and b at the first change of either"));
        };
        if self.unknown != [false; 2] {
            self.unknown_until.get_or_insert(self.now);
        }
        let state = State::new(a, b);
        let Some(scaled) = self.now.checked_mul(self.ns_per_unit.0) else {
            return Err(input.at_word(&format!("#{}", self.now), "a time below 18446744073709551616 ns"));
        };
        let t_ns = scaled / self.ns_per_unit.1;
        match last {
            Some(last) if last.state == state => Ok(None),
            Some(last) if last.t_ns >= t_ns => {
                let found = format!("two changes within the nanosecond {t_ns}");
                Err(input.at_word(&found, "changes at least 1 ns apart"))
            }
            _ => Ok(Some(TracePoint { t_ns, state })),
        }
    }
}

/// A finding about the word that was just read.
fn odd<R>(input: &LineReader<R>, word: &[u8], expected: &str) -> InputError {
    input.at_word(&quoted(&String::from_utf8_lossy(word)), expected)
}

fn word<R: Read>(input: &mut LineReader<R>) -> Result<Option<String>, InputError> {
    Ok(input.word()?.map(|range| String::from_utf8_lossy(input.bytes(range)).into_owned()))
}

/// The words up to `$end`.
fn until_end<R: Read>(input: &mut LineReader<R>) -> Result<Vec<String>, InputError> {
    let mut words = Vec::new();
    while let Some(word) = word(input)? {
        if word == "$end" {
            return Ok(words);
        }
        if words.len() > 16 {
            break;
        }
        words.push(word);
    }
    Err(input.at_word("no $end", "$end after a definition"))
}

/// Skips free text of any length up to `$end`.
fn skip_to_end<R: Read>(input: &mut LineReader<R>) -> Result<(), InputError> {
    while let Some(range) = input.word()? {
        if *input.bytes(range) == *b"$end" {
            return Ok(());
        }
    }
    Err(input.at_word("the end of the file", "$end"))
}

fn timescale<R>(input: &LineReader<R>, text: &str) -> Result<(u64, u64), InputError> {
    let digits = text.bytes().take_while(u8::is_ascii_digit).count();
    let (magnitude, unit) = text.split_at(digits);
    let magnitude = match magnitude {
        "1" => 1,
        "10" => 10,
        "100" => 100,
        _ => 0,
    };
    let (mul, div) = match unit {
        "s" => (1_000_000_000, 1),
        "ms" => (1_000_000, 1),
        "us" => (1_000, 1),
        "ns" => (1, 1),
        "ps" => (1, 1_000),
        "fs" => (1, 1_000_000),
        _ => (0, 1),
    };
    if magnitude * mul == 0 {
        return Err(input.at_word(&quoted(text), "1, 10 or 100 of s, ms, us, ns, ps or fs"));
    }
    Ok((magnitude * mul, div))
}

/// The identifier of a signal, and its name with the scopes around it.
type Signal = (Vec<u8>, String);

/// Takes the code of a or b from `$var TYPE SIZE CODE NAME [RANGE] $end`.
fn variable<R>(
    input: &LineReader<R>,
    body: &[String],
    names: [Option<&str>; 2],
    number: usize,
    scopes: &[String],
    codes: &mut [Option<Signal>; 2],
) -> Result<(), InputError> {
    let [_kind, size, code, name, ..] = body else {
        return Err(input.at_word(&quoted(&body.join(" ")), "$var TYPE SIZE CODE NAME $end"));
    };
    let path: String = scopes.iter().map(|scope| format!("{scope}.")).chain([name.clone()]).collect();
    let is_named = |signal: usize| match names[signal] {
        None => name.eq_ignore_ascii_case(["a", "b"][signal]),
        Some(wanted) => {
            let in_scope =
                path.strip_suffix(wanted).is_some_and(|front| front.is_empty() || front.ends_with('.'));
            wanted == name || in_scope || size == "1" && wanted.parse() == Ok(number)
        }
    };
    let Some(signal) = (0..2).find(|signal| is_named(*signal)) else { return Ok(()) };
    if size != "1" {
        return Err(input.at_word(&format!("{name} of {size} bits"), "one bit"));
    }
    let code = code.as_bytes().to_vec();
    if let Some((_, first)) = codes[signal].as_ref().filter(|(known, _)| *known != code) {
        let found = format!("a second variable named {name}, {path} beside {first}");
        let side = ["a", "b"][signal];
        let expected = if path == *first {
            format!("one {side}, or --columns {side}=NUMBER: its place among the variables of one bit")
        } else {
            format!("one {side}: --columns {side}={first} or {side}={path} selects it")
        };
        return Err(input.at_word(&found, &expected));
    }
    codes[signal] = Some((code, path));
    Ok(())
}
