//! Counts A and B; a change of both at once is illegal and adds no count.
use rtec_driver::quadrature::{Decoder, State};

#[cfg_attr(test, test)]
fn main() {
    let state = |bits: u8| State::from_bits(bits); // bit 0: A, bit 1: B
    let mut scale = Decoder::new(state(0b00));
    for bits in [0b01, 0b11, 0b10, 0b11] {
        scale.update(state(bits));
    }
    println!("{} counts, {} illegal", scale.count(), scale.illegal());
    assert_eq!((scale.count(), scale.illegal()), (2, 0)); // A leads: three forwards, one back
    assert_eq!(scale.update(state(0b00)), None); // from 11 to 00
    assert_eq!((scale.count(), scale.illegal()), (2, 1));
}
