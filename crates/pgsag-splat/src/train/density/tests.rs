use super::*;
use crate::backend::ViewCamera;
use crate::train::footprint::footprints;
use crate::train::trainer::fake::{camera_above, cloud_on_plane};
use pgsag_scene::numbers::SplitMix64;

/// Statistics of a plane of Gaussians whose texture pulls each with its own strength per metre of motion, as a camera
/// of this focal length gathers them: per pixel of motion they shrink with the resolution.
fn gathered(cloud: &SplatCloud, camera: &ViewCamera) -> DensityStatistics {
    let mut random = SplitMix64::new(5);
    let pulls: Vec<f32> = (0..cloud.len()).map(|_| random.range(0.0, 40.0) as f32).collect();
    let prints = footprints(&cloud.means, std::slice::from_ref(camera));
    let gradient: Vec<f32> = pulls.iter().zip(&prints).map(|(pull, print)| 3.0 * pull * print.gsd().min(1.0)).collect();
    DensityStatistics {
        absolute_gradient: gradient.iter().map(|g| 2.0 * g).collect(),
        gradient,
        visible_count: prints.iter().map(|p| 3 * u32::from(p.focal_px > 0.0)).collect(),
        radius_px: vec![1.0; cloud.len()],
        observed_count: vec![0; cloud.len()],
    }
}

fn plan(cloud: &SplatCloud, camera: &ViewCamera) -> DensityPlan {
    let statistics = gathered(cloud, camera);
    let footprints = footprints(&cloud.means, std::slice::from_ref(camera));
    let input = DensityInput {
        cloud,
        statistics: &statistics,
        footprints: &footprints,
        cull: true,
        agreement: None,
        seed: 1,
        iteration: 100,
    };
    plan_density(&input, &DensityOptions { gradient: 0.1, max_growth: 1.0, ..DensityOptions::default() })
}

#[test]
fn crops_and_scales_of_one_scene_decide_alike() {
    let cloud = cloud_on_plane(40, 4.0);
    let full = camera_above([0.0, 0.0], 5.0, 1000);
    let births = plan(&cloud, &full).births.len();
    assert!(births > 100, "{births}");
    for scaled in [250, 500, 2000, 4000] {
        let other = plan(&cloud, &camera_above([0.0, 0.0], 5.0, scaled)).births.len();
        assert!(other.abs_diff(births) * 20 <= births, "{scaled} px: {other}, not {births}");
    }
    let cropped = ViewCamera { pinhole: full.pinhole.cropped(250, 250, 500, 500), ..full };
    let inside: Vec<u32> = (0..cloud.len() as u32)
        .filter(|i| crate::train::footprint::locate(&cropped, cloud.means[*i as usize]).is_some())
        .collect();
    let of_crop = plan(&cloud, &cropped).births;
    let of_full = plan(&cloud, &full).births.into_iter().filter(|b| inside.contains(&b.parent)).collect::<Vec<_>>();
    assert!(of_crop.len().abs_diff(of_full.len()) * 20 <= of_full.len());
}

fn three(gradients: [f32; 3], sizes: [f32; 3]) -> (SplatCloud, DensityStatistics, Vec<Footprint>) {
    let mut cloud = cloud_on_plane(2, 1.0);
    cloud.log_scales.truncate(3);
    cloud.means.truncate(3);
    cloud.rotations.truncate(3);
    cloud.opacity_logits.truncate(3);
    cloud.harmonics.truncate(3 * 3 * cloud.basis_count());
    for (scale, size) in cloud.log_scales.iter_mut().zip(sizes) {
        *scale = [libm::logf(size); 3];
    }
    let statistics = DensityStatistics {
        gradient: gradients.to_vec(),
        absolute_gradient: vec![0.0; 3],
        visible_count: vec![1; 3],
        radius_px: vec![1.0; 3],
        observed_count: vec![0; 3],
    };
    (cloud, statistics, vec![Footprint { depth: 1000.0, focal_px: 1000.0 }; 3])
}

fn decide(
    (cloud, statistics, footprints): &(SplatCloud, DensityStatistics, Vec<Footprint>),
    options: &DensityOptions,
) -> DensityPlan {
    plan_density(
        &DensityInput { cloud, statistics, footprints, cull: true, agreement: None, seed: 3, iteration: 7 },
        options,
    )
}

#[test]
fn small_ones_are_cloned_and_large_ones_split() {
    let options = DensityOptions { gradient: 1.0, max_growth: 1.0, ..DensityOptions::default() };
    let made = decide(&three([2.0, 2.0, 0.5], [0.8, 3.0, 3.0]), &options);
    assert_eq!(made.keep, vec![0, 2]);
    assert_eq!(made.births.iter().map(|b| b.parent).collect::<Vec<_>>(), vec![0, 1, 1]);
    assert_eq!(made.births[0].log_scale_shift, 0.0);
    assert!((made.births[1].log_scale_shift + libm::logf(1.6)).abs() < 1e-6);
    assert_ne!(made.births[1].offset, made.births[2].offset);
}

#[test]
fn what_the_photographs_cannot_tell_apart_does_not_multiply() {
    let options = DensityOptions { gradient: 1.0, max_growth: 1.0, ..DensityOptions::default() };
    let mut scene = three([2.0; 3], [0.5, 0.5, 3.0]);
    scene.2 = vec![Footprint { depth: 1000.0, focal_px: 1000.0 }; 3];
    assert_eq!(decide(&scene, &options).births.iter().map(|b| b.parent).collect::<Vec<_>>(), vec![2, 2]);
    // In a photograph of twice the resolution the small ones are 1 px wide.
    scene.2 = vec![Footprint { depth: 1000.0, focal_px: 2000.0 }; 3];
    assert_eq!(decide(&scene, &options).births.len(), 4);
}

#[test]
fn faint_and_huge_ones_die_unless_a_reset_is_fresh() {
    let (mut cloud, statistics, footprints) = three([0.0; 3], [1.0, 1.0, 200.0]);
    cloud.opacity_logits = vec![-6.0, 0.0, 0.0];
    let mut input = DensityInput {
        cloud: &cloud,
        statistics: &statistics,
        footprints: &footprints,
        cull: true,
        agreement: None,
        seed: 0,
        iteration: 1,
    };
    assert_eq!(plan_density(&input, &DensityOptions::default()).keep, vec![1]);
    input.cull = false;
    assert_eq!(plan_density(&input, &DensityOptions::default()).keep, vec![0, 1]);
}

#[test]
fn a_full_budget_takes_the_steepest() {
    let options = DensityOptions { gradient: 1.0, max_growth: 1.0, max_gaussians: 4, ..DensityOptions::default() };
    let made = decide(&three([2.0, 9.0, 5.0], [0.8; 3]), &options);
    assert_eq!(made.keep.len() + made.births.len(), 4);
    assert_eq!(made.births[0].parent, 1);
    let none = decide(&three([2.0, 9.0, 5.0], [0.8; 3]), &DensityOptions { max_gaussians: 2, ..options });
    let third = DensityOptions { max_gaussians: 100, max_growth: 0.33, ..options };
    let strongest = decide(&three([2.0, 9.0, 5.0], [0.8; 3]), &third).births;
    assert_eq!(strongest.iter().map(|birth| birth.parent).collect::<Vec<_>>(), [1], "a third of three");
    assert!(none.births.is_empty());
}

#[test]
fn offsets_have_the_spread_of_their_parent() {
    let (mut cloud, ..) = three([0.0; 3], [1.0; 3]);
    cloud.log_scales[0] = [libm::logf(2.0), libm::logf(0.5), -20.0];
    // A quarter turn about z carries the long axis to y.
    cloud.rotations[0] = [0.5f32.sqrt(), 0.0, 0.0, 0.5f32.sqrt()];
    let mut random = SplitMix64::new(11);
    let mut square = [0.0f64; 3];
    for _ in 0..4000 {
        let offset = sample_offset(&cloud, 0, &mut random);
        for k in 0..3 {
            square[k] += f64::from(offset[k]).powi(2) / 4000.0;
        }
    }
    assert!((square[1] - 4.0).abs() < 0.4 && (square[0] - 0.25).abs() < 0.03 && square[2] < 1e-10, "{square:?}");
}

#[test]
fn trim_asks_only_of_views_that_could_see() {
    let options = DensityOptions::default();
    let trimmed = plan_trim(&[2, 1, 1, 0, 0], &[9, 9, 1, 1, 0], &options);
    assert_eq!(trimmed.keep, vec![0, 2]);
}

#[test]
fn copies_of_one_gaussian_look_as_it_did() {
    for (opacity, copies) in [(0.3, 2), (0.9, 3), (0.99, 10), (0.6, 1), (0.999, 51)] {
        let (each, factor) = relocate::shared(opacity, copies);
        assert!((1.0 - (1.0 - each).powi(copies as i32) - opacity).abs() < 1e-12, "{opacity} {copies}: {each}");
        // Sum over a line, of deviation 1: the copies' 1 - (1 - o' g)^N against the one's o g.
        let step = 1e-3;
        let (mut one, mut many) = (0.0, 0.0);
        for k in -12_000..=12_000 {
            let x = f64::from(k) * step;
            one += opacity * libm::exp(-0.5 * x * x) * step;
            many += (1.0 - (1.0 - each * libm::exp(-0.5 * (x / factor).powi(2))).powi(copies as i32)) * step;
        }
        assert!((one - many).abs() < 1e-6 * one, "{opacity} {copies}: {one} and {many}");
    }
}

#[test]
fn the_faint_are_born_again_where_opacity_is() {
    let (mut cloud, statistics, footprints) = three([0.0; 3], [2.0; 3]);
    cloud.opacity_logits = vec![-8.0, 2.0, -3.0];
    let input = DensityInput {
        cloud: &cloud,
        statistics: &statistics,
        footprints: &footprints,
        cull: true,
        agreement: None,
        seed: 7,
        iteration: 3,
    };
    let options = DensityOptions { gradient: 1.0, relocate: true, ..DensityOptions::default() };
    let plan = plan_density(&input, &options);
    assert_eq!(plan.keep.len() + plan.births.len(), 3, "nothing is lost: {plan:?}");
    assert!(!plan.keep.contains(&0) && plan.births.len() == 2);
    let parent = plan.births[0].parent;
    assert!(parent != 0 && !plan.keep.contains(&parent) && plan.births.iter().all(|birth| birth.parent == parent));
    let spare = DensityInput { cull: false, ..input };
    assert_eq!(plan_density(&spare, &options).keep, [0, 1, 2], "after a reset nobody dies");
    let drawn = |seed| plan_density(&DensityInput { seed, ..input }, &options).births[0].parent;
    let by_opacity = (0..400).filter(|seed| drawn(*seed) == 1).count();
    // 0.881 against 0.047.
    assert!((360..400).contains(&by_opacity), "{by_opacity} of 400");
}

#[test]
fn births_wait_for_views_that_show_an_error() {
    let cloud = cloud_on_plane(2, 1.0);
    let camera = camera_above([0.0, 0.0], 5.0, 100);
    let pixel = |i: usize| {
        let (_, at) = crate::train::footprint::locate(&camera, cloud.means[i]).expect("below the camera");
        at[1] as usize * 100 + at[0] as usize
    };
    let mut agreement = Agreement::of(cloud.len());
    let view = |errors: [Option<f32>; 4], depth: f32| {
        let mut error = vec![Some(0.1); 100 * 100];
        (0..4).for_each(|i| error[pixel(i)] = errors[i]);
        error[0] = Some(1.1);
        (vec![depth; 100 * 100], error)
    };
    // Gaussian 0 is wrong in both views, 1 in one, 2 in none, 3 where nothing is trained.
    for errors in [[Some(0.3), Some(0.3), Some(0.19), None], [Some(0.3), Some(0.1), Some(0.1), None]] {
        let (depth, error) = view(errors, 5.0);
        agreement.note(&cloud.means, &camera, &depth, &error);
    }
    // Another surface hides them all here.
    let (depth, error) = view([Some(1.0); 4], 4.0);
    agreement.note(&cloud.means, &camera, &depth, &error);
    let wrong = |share| [0, 1, 2, 3].map(|i| agreement.is_wrong(i, share));
    assert_eq!(wrong(0.6), [true, false, false, false]);
    assert_eq!(wrong(0.5), [true, true, false, false]);

    let statistics = DensityStatistics {
        gradient: vec![1e9; 4],
        absolute_gradient: vec![1e9; 4],
        visible_count: vec![1; 4],
        radius_px: vec![1.0; 4],
        observed_count: vec![1; 4],
    };
    let prints = footprints(&cloud.means, std::slice::from_ref(&camera));
    let input = DensityInput {
        cloud: &cloud,
        statistics: &statistics,
        footprints: &prints,
        cull: false,
        agreement: Some(&agreement),
        seed: 1,
        iteration: 100,
    };
    let options = DensityOptions { agreement: 0.5, max_growth: 1.0, ..DensityOptions::default() };
    let mut parents: Vec<u32> = plan_density(&input, &options).births.iter().map(|birth| birth.parent).collect();
    parents.dedup();
    assert_eq!(parents, [0, 1]);
    let all = DensityInput { agreement: None, ..input };
    assert!(plan_density(&all, &options).births.iter().any(|birth| birth.parent == 3));
}
