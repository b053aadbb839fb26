//! One affine exposure per image, learnt beside the cloud; the mean over the images stays neutral (method.md 8.5).

use crate::backend::Exposure;

/// Gains and biases with their Adam moments: per image `[gain R G B, bias R G B]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Exposures {
    pub(crate) values: Vec<[f32; 6]>,
    pub(crate) first: Vec<[f32; 6]>,
    pub(crate) second: Vec<[f32; 6]>,
    /// Steps taken by each image, for the bias correction.
    pub(crate) steps: Vec<u32>,
}

const BETA: [f32; 2] = [0.9, 0.999];
const NEUTRAL: [f32; 6] = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0];

impl Exposures {
    pub(crate) fn neutral(count: usize) -> Self {
        Self {
            values: vec![NEUTRAL; count],
            first: vec![[0.0; 6]; count],
            second: vec![[0.0; 6]; count],
            steps: vec![0; count],
        }
    }

    pub(crate) fn given(exposures: &[Exposure]) -> Self {
        let mut made = Self::neutral(exposures.len());
        for (value, exposure) in made.values.iter_mut().zip(exposures) {
            let ([r, g, b], [x, y, z]) = (exposure.gain, exposure.bias);
            *value = [r, g, b, x, y, z];
        }
        made
    }

    pub(crate) fn of(&self, view: usize) -> Exposure {
        let [r, g, b, x, y, z] = self.values[view];
        Exposure { gain: [r, g, b], bias: [x, y, z] }
    }

    pub(crate) fn all(&self) -> Vec<Exposure> {
        (0..self.values.len()).map(|view| self.of(view)).collect()
    }

    /// One Adam step of one image; then the mean over all images is moved back to neutral.
    pub(crate) fn step(&mut self, view: usize, d_gain: [f32; 3], d_bias: [f32; 3], rate: f32) {
        self.steps[view] += 1;
        let step = self.steps[view] as f32;
        let gradient = [d_gain[0], d_gain[1], d_gain[2], d_bias[0], d_bias[1], d_bias[2]];
        let corrections = BETA.map(|beta| 1.0 - libm::powf(beta, step));
        for k in 0..6 {
            let first = &mut self.first[view][k];
            *first = BETA[0] * *first + (1.0 - BETA[0]) * gradient[k];
            let second = &mut self.second[view][k];
            *second = BETA[1] * *second + (1.0 - BETA[1]) * gradient[k] * gradient[k];
            let direction = (*first / corrections[0]) / ((*second / corrections[1]).sqrt() + 1e-15);
            self.values[view][k] -= rate * direction;
        }
        let count = self.values.len() as f64;
        for k in 0..6 {
            let mean = self.values.iter().map(|v| f64::from(v[k])).sum::<f64>() / count;
            let excess = (mean - f64::from(NEUTRAL[k])) as f32;
            for value in &mut self.values {
                value[k] -= excess;
            }
        }
    }
}

#[cfg(test)]
mod tests;
