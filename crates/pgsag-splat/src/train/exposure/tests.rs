use super::*;

#[test]
fn descends_and_keeps_the_mean_neutral() {
    let mut exposures = Exposures::neutral(4);
    // One colour seen by four images, the first 20 % brighter; colour and gains are learnt together.
    let mut color = 0.5f32;
    for _ in 0..3000 {
        for view in 0..4 {
            let seen = if view == 0 { 0.6 } else { 0.5 };
            let gain = exposures.of(view).gain[0];
            let residual = gain * color - seen;
            exposures.step(view, [2.0 * residual * color; 3], [0.0; 3], 1e-3);
            color -= 0.1 * residual * gain;
        }
    }
    let gains: Vec<f32> = exposures.all().iter().map(|e| e.gain[0]).collect();
    assert!((gains.iter().sum::<f32>() / 4.0 - 1.0).abs() < 1e-5);
    assert!((gains[0] / gains[1] - 1.2).abs() < 0.02, "{gains:?}");
    assert_eq!(exposures.of(2).bias, [0.0; 3]);
}

#[test]
fn given_values_are_returned() {
    let given = [Exposure::NEUTRAL, Exposure { gain: [1.1, 1.0, 0.9], bias: [0.1, 0.0, -0.1] }];
    assert_eq!(Exposures::given(&given).all(), given);
}
