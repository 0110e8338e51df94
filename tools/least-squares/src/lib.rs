//! Least squares by orthogonal factors, for all crates.
//!
//! Products of columns are never formed, because they would square the condition number.
//!
//! | module | what | used by |
//! |---|---|---|
//! | [`factor`] | factors that grow column by column, with or without a prior | the estimator, and [`solve`] |
//! | [`solution`] | values, covariance, residual; equal rows for jackknives | fits, plates, circles |
//! | [`banded`] | smooth series: matrices with two bands beside the diagonal | temperatures without noise |
//! | [`rank_deficient_least_squares`] | values of dependent columns; the smallest of several solutions; eigenvalues | ballbar, smooth functions |

pub mod banded;
pub mod factor;
#[cfg(feature = "matrices")]
pub mod rank_deficient_least_squares;
pub mod solution;

pub use banded::BandedFactor;
#[cfg(feature = "matrices")]
pub use factor::products_beside;
pub use factor::{QrFactor, add, dot, prior_terms};
#[cfg(feature = "matrices")]
pub use rank_deficient_least_squares::{
    DeterminedDirections, orthonormal, principal, projected_eigen, projected_out,
};
pub use solution::{Solution, compress_rows, solve};

#[cfg(test)]
mod tests {
    use std::path::Path;

    /// No other crate may factor: it would be a second solver.
    #[test]
    fn no_other_room_factors() {
        let tools = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let mut folders: Vec<_> =
            std::fs::read_dir(tools).unwrap().map(|d| d.unwrap().path().join("src")).collect();
        let mut read = 0;
        while let Some(folder) = folders.pop() {
            if folder.starts_with(tools.join("least-squares")) {
                continue;
            }
            for file in std::fs::read_dir(folder).into_iter().flatten().map(|f| f.unwrap().path()) {
                if file.is_dir() {
                    folders.push(file);
                } else if file.extension().is_some_and(|e| e == "rs") {
                    let text = std::fs::read_to_string(&file).unwrap();
                    // A test may use another solver as a judge.
                    let own = text.split("#[cfg(test)]").next().unwrap_or_default();
                    // Nor by hand: a factorisation that is written out says whose it is.
                    for way in [
                        ".qr(",
                        ".svd(",
                        ".cholesky(",
                        ".lu(",
                        "inverse(1e",
                        "try_inverse",
                        "symmetric_eigen",
                        "SymmetricEigen",
                        "Cholesky",
                        "Gram–Schmidt",
                        "Householder",
                        "Givens",
                        "orthonormal basis",
                        "ormal equations",
                    ] {
                        assert!(!own.contains(way), "{}: {way}", file.display());
                    }
                    read += 1;
                }
            }
        }
        assert!(read > 300, "{read} files");
    }
}
