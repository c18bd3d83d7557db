//! Fits of a model to data, and how sure they are.
//!
//! ```
//! use nalgebra::DVector;
//! use twum_fit::least_squares::Search;
//! use twum_fit::quantile::NORMAL_95;
//!
//! // y = a·exp(b·t), seen with a scatter of 0.1; nothing is known of ln a, of ln b that it is within one of ln 0.5.
//! let data: Vec<f64> = (0..20).map(|t| 3.0 * (0.5 * 0.1 * f64::from(t)).exp()).collect();
//! let predict = |x: &DVector<f64>| {
//!     DVector::from_fn(20, |t, _| x[0].exp() * (0.5 * x[1].exp() * 0.1 * t as f64).exp())
//! };
//! let search = Search { data: &data, sigma: &[0.1; 20], priors: &[1.0], steps: &[1e-2, 1e-2], predict: &predict };
//! let best = search.settle(DVector::from_vec(vec![0.5, 0.0]), false, None);
//! assert!((best.x[0].exp() - 3.0).abs() < 0.01);
//! // Where the model hardly bends, the profile's end is where the covariance says.
//! let (normal, _) = search.normal_equations(&best);
//! let sd = normal.try_inverse().expect("both are seen")[(0, 0)].sqrt();
//! let end = search.end(&best, 1.0).x0 - best.x[0];
//! assert!((end / (NORMAL_95 * sd) - 1.0).abs() < 0.1);
//! ```

pub mod descent;
pub mod least_squares;
pub mod noise;
pub mod normal;
pub mod quantile;
