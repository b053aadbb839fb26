//! Eigenvalues of small symmetric matrices, by cyclic Jacobi rotations (Golub and Van Loan, section 8.5).

/// Eigenvalues in rising order with their unit eigenvectors (`vectors[i]` belongs to `values[i]`).
#[must_use]
pub fn symmetric_eigen<const N: usize>(mut matrix: [[f64; N]; N]) -> ([f64; N], [[f64; N]; N]) {
    const MAX_SWEEPS: usize = 50;
    let mut basis = [[0.0; N]; N];
    (0..N).for_each(|i| basis[i][i] = 1.0);
    for _ in 0..MAX_SWEEPS {
        let outside: f64 =
            (0..N).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| matrix[i][j] * matrix[i][j]).sum();
        let all: f64 = matrix.iter().flatten().map(|value| value * value).sum();
        if outside <= all * 1e-32 || !all.is_finite() {
            break;
        }
        for p in 0..N {
            for q in p + 1..N {
                rotate(&mut matrix, &mut basis, p, q);
            }
        }
    }
    let mut order: [usize; N] = std::array::from_fn(|i| i);
    order.sort_by(|&a, &b| matrix[a][a].total_cmp(&matrix[b][b]));
    (order.map(|i| matrix[i][i]), order.map(|i| std::array::from_fn(|row| basis[row][i])))
}

/// Makes `matrix[p][q]` zero by a rotation in the plane of p and q.
fn rotate<const N: usize>(matrix: &mut [[f64; N]; N], basis: &mut [[f64; N]; N], p: usize, q: usize) {
    if matrix[p][q] == 0.0 {
        return;
    }
    let theta = (matrix[q][q] - matrix[p][p]) / (2.0 * matrix[p][q]);
    let t = if theta >= 0.0 { 1.0 } else { -1.0 } / (theta.abs() + (theta * theta + 1.0).sqrt());
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    for k in 0..N {
        let (a, b) = (matrix[k][p], matrix[k][q]);
        (matrix[k][p], matrix[k][q]) = (c * a - s * b, s * a + c * b);
    }
    for k in 0..N {
        let (a, b) = (matrix[p][k], matrix[q][k]);
        (matrix[p][k], matrix[q][k]) = (c * a - s * b, s * a + c * b);
    }
    for row in basis {
        let (a, b) = (row[p], row[q]);
        (row[p], row[q]) = (c * a - s * b, s * a + c * b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numbers::SplitMix64;

    #[test]
    fn vectors_are_those_of_the_values() {
        let mut stream = SplitMix64::new(4);
        for _ in 0..50 {
            let mut matrix = [[0.0; 4]; 4];
            for i in 0..4 {
                for j in 0..=i {
                    matrix[i][j] = stream.normal() * 10.0;
                    matrix[j][i] = matrix[i][j];
                }
            }
            let (values, vectors) = symmetric_eigen(matrix);
            assert!(values.is_sorted());
            for (value, vector) in values.iter().zip(&vectors) {
                for row in 0..4 {
                    let product: f64 = (0..4).map(|k| matrix[row][k] * vector[k]).sum();
                    assert!((product - value * vector[row]).abs() < 1e-12 * 40.0);
                }
            }
        }
    }
}
