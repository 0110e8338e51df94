//! Fits a probed nose with a bump.
//! Points that do not belong to the circle are left out of the fit, so that their errors show.
use rtec_part::geometric_fit::{FitShape, FittedShape, Zx, two_step};

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let bump = 4..7;
    let touch = |k: u32| {
        let angle = f64::from(k) / 19.0 * std::f64::consts::FRAC_PI_2;
        let r = 38.1 + if bump.contains(&k) { 0.02 } else { 0.000_2 * f64::from(k % 2) };
        Zx::new(127.0 + r * angle.cos(), r * angle.sin())
    };
    let points: Vec<Zx> = (0..20).map(touch).collect();
    let fit = two_step(FitShape::Circle, &points)?;
    let FittedShape::Circle { centre, radius_mm } = fit.fitted else {
        return Err("a circle was asked for".into());
    };
    println!(
        "centre {:.4}, {:.4}, radius {radius_mm:.4} mm, left out: {:?}",
        centre.z, centre.x, fit.rejected
    );
    assert!((radius_mm - 38.1).abs() < 0.001 && (centre.z - 127.0).abs() < 0.001);
    assert!(bump.clone().all(|k| fit.rejected.contains(&(k as usize))));
    assert!((fit.fitted.deviation_mm(points[5]) - 0.02).abs() < 0.001);
    Ok(())
}
