//! NC programs of the simulated controller.
//! It knows G00 to G04, G17 to G19, G90, G91, M03, M05, M08, M09, F and S.

use crate::path::AXES;
use rtec_files::InputError;
use std::path::Path;

/// One block, all positions absolute, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Block {
    /// G00: rapid positioning.
    Rapid {
        /// End point, mm.
        to: [f64; AXES],
    },
    /// G01: a straight line at a feed.
    Feed {
        /// End point, mm.
        to: [f64; AXES],
        /// Feed along the path, mm/s.
        feed_mm_s: f64,
    },
    /// G02, G03: an arc at a feed.
    Arc {
        /// End point, mm.
        to: [f64; AXES],
        /// The plane's first and second axis.
        plane: (usize, usize),
        /// Centre in the plane, mm.
        centre: (f64, f64),
        /// Clockwise (G02), else counter-clockwise (G03).
        clockwise: bool,
        /// Feed along the path, mm/s.
        feed_mm_s: f64,
    },
    /// G04: a dwell.
    Dwell {
        /// Duration, s.
        seconds: f64,
    },
    /// M03 S…, M05: spindle on at a speed, or off.
    Spindle {
        /// Speed, rpm; 0 stops it.
        rpm: f64,
    },
    /// M08, M09: coolant on or off.
    Coolant {
        /// The coolant flows (M08).
        on: bool,
    },
}

/// Parses a program that starts at `start` (mm). Axis letters are X, Y, Z.
///
/// # Errors
/// The first word that is unknown or incomplete, with its line and column.
pub fn parse(file: &Path, text: &str, start: [f64; AXES]) -> Result<Vec<Block>, InputError> {
    let mut blocks = Vec::new();
    let mut at = start;
    let (mut motion, mut plane, mut relative) = (0_u32, (0, 1), false);
    let (mut feed, mut rpm) = (None::<f64>, 0.0);
    for (number, line) in text.lines().enumerate() {
        let bad = |column: usize, found: &str, expected: &str| {
            InputError::at(file, number + 1, column, found.to_owned(), expected.to_owned())
        };
        let mut to = at;
        let mut centre: [Option<f64>; AXES] = [None; AXES];
        let (mut moves, mut dwell, mut pause, mut events) = (false, false, None, Vec::new());
        for (column, letter, value) in
            words(line).map_err(|(c, found)| bad(c, &found, "a word like X12.5"))?
        {
            let code = (value * 10.0).round() as i64;
            match letter {
                'N' | 'O' | '%' => {}
                'G' => match code {
                    0 | 10 | 20 | 30 => motion = (code / 10) as u32,
                    40 => dwell = true,
                    170 => plane = (0, 1),
                    180 => plane = (2, 0),
                    190 => plane = (1, 2),
                    900 => relative = false,
                    910 => relative = true,
                    210 | 400 | 540 | 610 | 940 => {}
                    _ => {
                        return Err(bad(
                            column,
                            &format!("G{value}"),
                            "G00 to G04, G17 to G19, G21, G90, G91",
                        ));
                    }
                },
                'X' | 'Y' | 'Z' => {
                    let n = letter as usize - 'X' as usize;
                    to[n] = if relative { at[n] + value } else { value };
                    moves = true;
                }
                'I' | 'J' | 'K' => centre[letter as usize - 'I' as usize] = Some(value),
                'F' if value > 0.0 => feed = Some(value / 60.0),
                'S' if value >= 0.0 => rpm = value,
                'P' if value >= 0.0 => pause = Some(value),
                'M' => match code {
                    30 | 40 => events.push(None),
                    50 => events.push(Some(Block::Spindle { rpm: 0.0 })),
                    80 => events.push(Some(Block::Coolant { on: true })),
                    90 => events.push(Some(Block::Coolant { on: false })),
                    0 | 20 | 300 => {}
                    _ => return Err(bad(column, &format!("M{value}"), "M03, M05, M08, M09 or M30")),
                },
                _ => {
                    return Err(bad(
                        column,
                        &format!("{letter}{value}"),
                        "G, M, X, Y, Z, I, J, K, F, S, P or N",
                    ));
                }
            }
        }
        blocks.extend(events.into_iter().map(|e| e.unwrap_or(Block::Spindle { rpm })));
        if dwell {
            let seconds = pause.ok_or_else(|| bad(1, "G04 without P", "G04 P… (seconds)"))?;
            blocks.push(Block::Dwell { seconds });
        } else if moves || motion >= 2 && centre.iter().any(Option::is_some) {
            let speed = || feed.ok_or_else(|| bad(1, "a move without a feed", "F… (mm/min) before it"));
            blocks.push(match motion {
                0 => Block::Rapid { to },
                1 => Block::Feed { to, feed_mm_s: speed()? },
                _ => {
                    let (i, j) = plane;
                    let c = (at[i] + centre[i].unwrap_or(0.0), at[j] + centre[j].unwrap_or(0.0));
                    let r0 = libm::hypot(at[i] - c.0, at[j] - c.1);
                    let r1 = libm::hypot(to[i] - c.0, to[j] - c.1);
                    if r0 < 1e-6 || (r0 - r1).abs() > 0.002 {
                        let found =
                            format!("an arc with radius {r0:.4} mm at its start and {r1:.4} mm at its end");
                        return Err(bad(1, &found, "one radius, from I, J, K"));
                    }
                    Block::Arc { to, plane, centre: c, clockwise: motion == 2, feed_mm_s: speed()? }
                }
            });
            at = to;
        }
    }
    Ok(blocks)
}

/// A word of a block: column, letter, value.
type Word = (usize, char, f64);

/// The words of a line: column, letter, value.
/// Comments in parentheses and after a semicolon are left out.
fn words(line: &str) -> Result<Vec<Word>, (usize, String)> {
    let mut found = Vec::new();
    let chars: Vec<char> = line.split(';').next().unwrap_or("").to_ascii_uppercase().chars().collect();
    let mut k = 0;
    while k < chars.len() {
        if chars[k] == '(' {
            k += chars[k..].iter().position(|&c| c == ')').ok_or((k + 1, "an open comment".to_owned()))? + 1;
        } else if chars[k].is_ascii_alphabetic() {
            let from = k;
            k += 1;
            while k < chars.len() && (chars[k].is_ascii_digit() || "+-. ".contains(chars[k])) {
                k += 1;
            }
            let text: String = chars[from + 1..k].iter().filter(|c| **c != ' ').collect();
            let value = text.parse::<f64>().map_err(|_| (from + 1, format!("`{}{text}`", chars[from])))?;
            found.push((from + 1, chars[from], value));
        } else if chars[k] == '%' || chars[k].is_whitespace() {
            k += 1;
        } else {
            return Err((k + 1, format!("`{}`", chars[k])));
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<Block>, InputError> {
        parse(Path::new("p.ngc"), text, [0.0; 3])
    }

    #[test]
    fn a_program_reads() {
        let blocks = read(
            "%\nN10 G21 G90 G00 X10 Z5 (to the start)\nM3 S1200\nG1 Z0 F600; down\nG18 G2 X20 Z-10 I10 K0\n\
                           G04 P0.5\nM5 M9\nG91 G1 X-1\nM30\n",
        )
        .unwrap();
        assert_eq!(blocks[0], Block::Rapid { to: [10.0, 0.0, 5.0] });
        assert_eq!(blocks[1], Block::Spindle { rpm: 1200.0 });
        assert_eq!(blocks[2], Block::Feed { to: [10.0, 0.0, 0.0], feed_mm_s: 10.0 });
        let Block::Arc { plane, centre, clockwise, .. } = blocks[3] else { panic!("{:?}", blocks[3]) };
        assert_eq!((plane, centre, clockwise), ((2, 0), (0.0, 20.0), true));
        assert_eq!(blocks[4], Block::Dwell { seconds: 0.5 });
        assert_eq!(blocks[7], Block::Feed { to: [19.0, 0.0, -10.0], feed_mm_s: 10.0 });
    }

    #[test]
    fn findings_carry_line_and_column() {
        for (text, line, column, found) in [
            ("G0 X1\nG1 X2\n", 2, 1, "without a feed"),
            ("G0 X1 Q3\n", 1, 7, "Q3"),
            ("G77\n", 1, 1, "G77"),
            ("G1 F100 X\n", 1, 9, "`X`"),
            ("G2 F100 X10 I1\n", 1, 1, "radius"),
            ("G4\n", 1, 1, "without P"),
            ("G0 X1 (open\n", 1, 7, "open comment"),
        ] {
            let e = read(text).unwrap_err();
            assert_eq!((e.line, e.column), (line, column), "{text}: {e}");
            assert!(e.to_string().contains(found), "{e}");
        }
    }
}
