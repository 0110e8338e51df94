//! Parses a number with a decimal point.
//! A fast path serves if it is exact, the standard library otherwise.

/// The minus sign of typography (U+2212), which some countries' spreadsheets write.
const MINUS: char = '\u{2212}';
/// Signs that a number may begin with.
pub(crate) const SIGNS: [char; 3] = ['+', '-', MINUS];

/// Parses a number with a decimal point, after either minus sign.
/// `None` if it is not a number or not finite.
pub(crate) fn number(text: &str) -> Option<f64> {
    let pointed = |text: &str| text.parse().ok().filter(|v: &f64| v.is_finite());
    match text.strip_prefix(MINUS) {
        Some(rest) => pointed(rest).filter(|_| !rest.starts_with(SIGNS)).map(|v| -v),
        None => pointed(text),
    }
}

/// [`decimal_parser`] if the number is the whole text.
#[inline]
pub(crate) fn plain_decimal(text: &[u8]) -> Option<f64> {
    decimal(text).filter(|(_, length)| *length == text.len()).map(|(number, _)| number)
}

/// A short decimal number at the start of a text, and its length in bytes.
/// The digits and the power of ten are exact, so their quotient is rounded only once. The result equals the
/// standard library's, but is faster. `None` for all other numbers.
#[allow(clippy::inline_always)] // as a function of its own it takes a third more: 20 instructions of 89
#[inline(always)]
pub(crate) fn decimal(text: &[u8]) -> Option<(f64, usize)> {
    let negative = *text.first()? == b'-';
    let digits = &text[usize::from(negative)..];
    let (number, length) = short_decimal(digits).or_else(|| long_decimal(digits))?;
    // The sign's bit is set without a branch, because signs cannot be predicted.
    let number = f64::from_bits(number.to_bits() | u64::from(negative) << 63);
    Some((number, usize::from(negative) + length))
}

/// Powers of ten that are exact. Any whole number of that many digits is exact too.
const TENS: [f64; 16] =
    [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];

/// [`decimal_parser`] without a sign, for at most eight bytes, as nearly all are.
/// All bytes are processed at once as one word, the first byte lowest. The number ends before a byte below
/// the point: a comma or the end of the line.
#[inline]
fn short_decimal(text: &[u8]) -> Option<(f64, usize)> {
    const fn each(byte: u8) -> u64 {
        u64::from_le_bytes([byte; 8])
    }
    let eight = u64::from_le_bytes(*text.first_chunk()?);
    // Subtraction borrows for a byte below `.`, which sets its high bit. That is certain for the lowest such
    // byte.
    let end = (eight.wrapping_sub(each(b'.')) & !eight & each(0x80)).trailing_zeros() / 8;
    if end == 0 || end == 8 && text.get(8).is_none_or(|byte| matches!(byte, b'.'..=b'9')) {
        return None;
    }
    // Removes what follows the number, and fills with zeros before it.
    let mut digits = eight << (8 * (8 - end));
    let points = digits ^ each(b'.');
    let point = points.wrapping_sub(each(1)) & !points & each(0x80);
    let (mut count, mut behind) = (end, 0);
    if point != 0 {
        // Moves the digits before the point next to those after it.
        let place = point.trailing_zeros() / 8;
        let before = (1 << (8 * place)) - 1;
        digits = (digits & before) << 8 | digits & (!0xFF << (8 * place));
        (count, behind) = (end - 1, 7 - place);
    }
    if count == 0 {
        return None;
    }
    let values = digits ^ (each(b'0') << (8 * (8 - count)));
    // A byte of 10 or more has a bit in its upper half, or gets one by adding six.
    if (values | values.wrapping_add(each(6))) & each(0xF0) != 0 {
        return None;
    }
    // Combines digits to pairs, pairs to fours, fours to the number.
    let pairs = (values * 10 + (values >> 8)) & 0x00FF_00FF_00FF_00FF;
    let fours = (pairs * 100 + (pairs >> 16)) & 0x0000_FFFF_0000_FFFF;
    let whole = (fours * 10_000 + (fours >> 32)) & 0xFFFF_FFFF;
    Some((whole as i64 as f64 / TENS[behind as usize], end as usize))
}

/// [`decimal_parser`] without a sign, byte by byte.
#[inline(never)]
fn long_decimal(text: &[u8]) -> Option<(f64, usize)> {
    // A number too long to be exact may overflow here; the check below rejects it.
    let digits = |mut whole: i64, mut at: usize| {
        while let Some(digit) = text.get(at).map(|byte| byte.wrapping_sub(b'0')).filter(|digit| *digit <= 9) {
            whole = whole.wrapping_mul(10).wrapping_add(i64::from(digit));
            at += 1;
        }
        (whole, at)
    };
    let (mut whole, mut end) = digits(0, 0);
    let (mut count, mut behind) = (end, 0);
    if text.get(end) == Some(&b'.') {
        let point = end;
        (whole, end) = digits(whole, point + 1);
        behind = end - point - 1;
        count += behind;
    }
    (1..TENS.len()).contains(&count).then(|| (whole as f64 / TENS[behind], end))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The fast path equals the standard library's parser to the last bit, or declines.
    #[test]
    fn the_short_way_to_a_number_gives_the_same_one() {
        for text in [
            "0",
            "-0",
            "-0.0",
            ".5",
            "5.",
            "007",
            "999999999999999",
            "0.00000000000001",
            "99999999999999.9",
            "123.4567",
        ] {
            let std: f64 = text.parse().unwrap();
            assert_eq!(plain_decimal(text.as_bytes()).map(f64::to_bits), Some(std.to_bits()), "{text}");
        }
        for text in [
            "",
            "-",
            ".",
            "-.",
            "+1",
            "1e3",
            "nan",
            "inf",
            "1.2.3",
            "1_0",
            "1,0",
            "--1",
            "9007199254740993",
            "0.1234567890123456",
            "٣",
        ] {
            assert_eq!(plain_decimal(text.as_bytes()), None, "{text}");
        }
        let mut random = 12345_u64;
        for _ in 0..200_000 {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let (digits, places) = (random >> (14 + random % 50), (random >> 7) as usize % 14);
            let text = format!("{:.places$}", digits as f64 / 10_f64.powi(places as i32));
            if let Some(short) = plain_decimal(text.as_bytes()) {
                assert_eq!(short.to_bits(), text.parse::<f64>().unwrap().to_bits(), "{text}");
            }
        }
    }
}
