use super::fake::{Fake, FakeViews, cloud_on_plane, ring_neighbors};
use super::*;
use crate::train::density::DensityOptions;

fn options() -> TrainOptions {
    TrainOptions {
        iterations: 500,
        density: DensityOptions { gradient: 1e-3, max_growth: 1.0, trim_interval: 200, ..DensityOptions::default() },
        ..TrainOptions::default()
    }
}

fn trainer<'a>(backend: &'a Fake, views: &'a FakeViews) -> Trainer<'a, Fake> {
    let neighbors = ring_neighbors(views.len());
    Trainer::new(backend, views, neighbors, cloud_on_plane(4, 1.0), options(), 9).expect("fakes do not fail")
}

#[test]
fn every_view_has_its_turn_before_any_has_two() {
    let (backend, views) = (Fake::default(), FakeViews::ring(5, 16));
    let mut trainer = trainer(&backend, &views);
    let drawn: Vec<usize> = (0..20).map(|_| trainer.step().expect("fake").view).collect();
    for round in drawn.chunks(5) {
        let mut sorted = round.to_vec();
        sorted.sort_unstable();
        assert_eq!(sorted, vec![0, 1, 2, 3, 4]);
    }
    assert_ne!(drawn[..5], drawn[5..10], "rounds are shuffled anew");
}

#[test]
fn neighbours_are_rendered_only_while_geometry_counts() {
    let (backend, views) = (Fake::default(), FakeViews::ring(5, 16));
    let mut trainer = trainer(&backend, &views);
    let start = (500.0 * options().geometric_start).round() as u32;
    trainer.run(start, &mut |_| ControlFlow::Continue(())).expect("fake");
    assert_eq!(backend.calls("render planes"), 0);
    trainer.run(start + 10, &mut |_| ControlFlow::Continue(())).expect("fake");
    assert_eq!(backend.calls("render planes"), 20);
}

#[test]
fn a_resumed_run_is_the_run_itself() {
    let (backend, views) = (Fake::default(), FakeViews::ring(5, 16));
    let mut straight = trainer(&backend, &views);
    let mut seen = Vec::new();
    straight
        .run(u32::MAX, &mut |p| {
            seen.push((p.iteration, p.view, p.gaussians));
            ControlFlow::Continue(())
        })
        .expect("fake");
    assert!(straight.is_done() && seen.len() == 500);
    let most = seen.iter().map(|step| step.2).max().expect("steps");
    assert!(most > 16, "the cloud grew");
    assert!(most <= options().gaussian_bound(16), "{most} Gaussians, no more than is known before");
    for stop in [1, 99, 100, 203, 499] {
        let mut first = trainer(&backend, &views);
        first.run(stop, &mut |_| ControlFlow::Continue(())).expect("fake");
        let bytes = first.checkpoint().expect("fake").to_bytes();
        let checkpoint = Checkpoint::from_bytes(&bytes).expect("own bytes");
        let mut resumed =
            Trainer::resume(&backend, &views, ring_neighbors(5), options(), &checkpoint).expect("same options");
        resumed.run(u32::MAX, &mut |_| ControlFlow::Continue(())).expect("fake");
        assert_eq!(resumed.checkpoint().expect("fake").to_bytes(), straight.checkpoint().expect("fake").to_bytes());
    }
}

#[test]
fn other_options_are_refused_but_other_bounds_are_not() {
    let (backend, views) = (Fake::default(), FakeViews::ring(5, 16));
    let checkpoint = trainer(&backend, &views).checkpoint().expect("fake");
    let other = TrainOptions { iterations: 600, ..options() };
    let resume = |options| Trainer::resume(&backend, &views, ring_neighbors(5), options, &checkpoint);
    assert!(matches!(resume(other), Err(TrainError::Checkpoint(_))));
    assert!(resume(TrainOptions { view_cache_bytes: 1, ..options() }).is_ok());
}

#[test]
fn divergence_names_iteration_and_view() {
    let (backend, views) = (Fake::poisoned_at(3), FakeViews::ring(5, 16));
    let mut trainer = trainer(&backend, &views);
    let mut views_drawn = Vec::new();
    let error = loop {
        match trainer.step() {
            Ok(progress) => views_drawn.push(progress.view),
            Err(error) => break error,
        }
    };
    assert_eq!(views_drawn.len(), 2);
    assert!(matches!(error, TrainError::NotFinite { iteration: 3, view, .. } if !views_drawn.contains(&view)));
}

#[test]
fn trim_renders_every_view_and_breaks_are_obeyed() {
    let (backend, views) = (Fake::default(), FakeViews::ring(5, 16));
    let mut trainer = trainer(&backend, &views);
    trainer.run(199, &mut |_| ControlFlow::Continue(())).expect("fake");
    let before = backend.calls("render colour");
    trainer.run(200, &mut |_| ControlFlow::Continue(())).expect("fake");
    assert_eq!(backend.calls("render colour") - before, 5);
    trainer.run(500, &mut |_| ControlFlow::Break(())).expect("fake");
    assert_eq!(trainer.iteration(), 201);
}

#[test]
fn exposures_may_be_frozen() {
    let (backend, views) = (Fake::default(), FakeViews::ring(5, 16));
    let given = vec![Exposure { gain: [1.1, 1.0, 1.0], bias: [0.0, 0.2, 0.0] }; 5];
    let mut frozen = trainer(&backend, &views).with_exposures(&given, true).expect("five");
    let mut free = trainer(&backend, &views);
    for _ in 0..5 {
        frozen.step().expect("fake");
        free.step().expect("fake");
    }
    assert_eq!(frozen.finish().expect("fake").1, given);
    assert_ne!(free.exposures(), vec![Exposure::NEUTRAL; 5]);
}

#[test]
fn a_loss_that_rests_ends_the_run_at_the_same_step_however_often_it_is_resumed() {
    let (backend, views) = (Fake::default(), FakeViews::ring(5, 16));
    let options = TrainOptions { plateau_share: 0.5, plateau_steps: 8, ..options() };
    let go = &mut |_: &Progress| ControlFlow::Continue(());
    let begin = || {
        let neighbors = ring_neighbors(views.len());
        Trainer::new(&backend, &views, neighbors, cloud_on_plane(4, 1.0), options.clone(), 9).expect("fake")
    };
    let mut straight = begin();
    straight.run(u32::MAX, go).expect("fake");
    // Three blocks of two rounds of five views after everything has settled.
    assert_eq!(straight.iteration(), options.settled_at() + 30);
    for stop in [options.settled_at() - 3, options.settled_at() + 17] {
        let mut first = begin();
        first.run(stop, go).expect("fake");
        let checkpoint = Checkpoint::from_bytes(&first.checkpoint().expect("fake").to_bytes()).expect("own bytes");
        let neighbors = ring_neighbors(views.len());
        let mut resumed = Trainer::resume(&backend, &views, neighbors, options.clone(), &checkpoint).expect("fake");
        resumed.run(u32::MAX, go).expect("fake");
        assert!(resumed.is_done());
        assert_eq!(resumed.iteration(), straight.iteration());
    }
}
