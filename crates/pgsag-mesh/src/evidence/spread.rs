//! Order statistics that false matches cannot move, and what is left of a spread when the witness's own noise is taken
//! out of it.

use pgsag_scene::numbers::median;
use serde::{Deserialize, Serialize};

/// Median absolute deviation to standard deviation, of normal errors.
const SIGMAS_PER_MAD: f64 = 1.482_602_218_505_602;
/// Halvings of the interval in which the mesh's own spread is looked for.
const HALVINGS: u32 = 24;

/// What many small measurements of one mesh say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// How many.
    pub count: u64,
    /// Their median; positive = the mesh lies outside. `None` of nothing, as the rest.
    pub bias: Option<f64>,
    /// 1.4826 times the median absolute deviation from the median: the standard deviation of normal errors.
    pub sigma: Option<f64>,
    /// Median of what each measurement says of its own standard deviation.
    pub noise: Option<f64>,
    /// Standard deviation of the mesh alone that, with the noise of each, explains `sigma`; 0 where noise explains all.
    pub net: Option<f64>,
}

impl Spread {
    /// The same in another unit.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        let by = |value: Option<f64>| value.map(|value| value * factor);
        Self { count: self.count, bias: by(self.bias), sigma: by(self.sigma), noise: by(self.noise), net: by(self.net) }
    }
}

/// Of measurements `[value, standard deviation]`.
#[must_use]
pub fn spread(measured: &[[f64; 2]]) -> Spread {
    let mut values: Vec<f64> = measured.iter().map(|m| m[0]).collect();
    let Some(bias) = median(&mut values) else { return Spread::default() };
    let sigma = scatter(measured, bias, |_| 1.0);
    let noise = median(&mut measured.iter().map(|m| m[1]).collect::<Vec<_>>());
    Spread {
        count: measured.len() as u64,
        bias: Some(bias),
        sigma: Some(sigma),
        noise,
        net: Some(net(measured, bias, sigma)),
    }
}

/// Robust standard deviation of the values about `bias`, each divided by what `unit` makes of its own.
pub(super) fn scatter(measured: &[[f64; 2]], bias: f64, unit: impl Fn(f64) -> f64) -> f64 {
    let mut off: Vec<f64> = measured.iter().map(|m| (m[0] - bias).abs() / unit(m[1])).collect();
    SIGMAS_PER_MAD * median(&mut off).unwrap_or(0.0)
}

/// The `s` for which values divided by `sqrt(noise^2 + s^2)` scatter by 1.
fn net(measured: &[[f64; 2]], bias: f64, sigma: f64) -> f64 {
    let scatter = |s: f64| scatter(measured, bias, |noise| (noise * noise + s * s).sqrt().max(f64::MIN_POSITIVE));
    if scatter(0.0) <= 1.0 {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, sigma);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if scatter(middle) > 1.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use pgsag_scene::numbers::SplitMix64;

    use super::*;

    #[test]
    fn noise_of_many_sizes_is_taken_out_and_outliers_do_not_count() {
        let mut random = SplitMix64::new(5);
        let mut measured: Vec<[f64; 2]> = (0..20_000)
            .map(|i| {
                let noise = [0.2, 1.0, 3.0][i % 3];
                [0.5 + 0.7 * random.normal() + noise * random.normal(), noise]
            })
            .collect();
        for (k, one) in measured.iter_mut().enumerate().filter(|(k, _)| k % 50 == 0) {
            one[0] += if k % 100 == 0 { 40.0 } else { -40.0 };
        }
        let found = spread(&measured);
        let (bias, net) = (found.bias.expect("some"), found.net.expect("some"));
        assert!((bias - 0.5).abs() < 0.03, "{bias}");
        assert!((net - 0.7).abs() < 0.06, "{net}");
        assert!(found.sigma.expect("some") > 1.0);
        assert_eq!(found.scaled(2.0).bias, Some(2.0 * bias));
    }

    #[test]
    fn where_noise_explains_all_nothing_is_left() {
        let measured: Vec<[f64; 2]> = (0..99).map(|i| [f64::from(i) - 49.0, 100.0]).collect();
        assert_eq!(spread(&measured).net, Some(0.0));
        assert_eq!(spread(&[]), Spread::default());
    }
}
