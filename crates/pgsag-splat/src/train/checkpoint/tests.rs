use super::*;
use crate::train::trainer::fake::{Fake, FakeViews, cloud_on_plane, ring_neighbors};
use crate::train::trainer::{Trainer, ViewSource};
use proptest::prelude::*;

fn some_checkpoint() -> Checkpoint {
    let (backend, views) = (Fake::default(), FakeViews::ring(5, 16));
    let options = TrainOptions { iterations: 500, ..TrainOptions::default() };
    let mut trainer =
        Trainer::new(&backend, &views, ring_neighbors(views.len()), cloud_on_plane(4, 1.0), options, 9).expect("fake");
    for _ in 0..7 {
        trainer.step().expect("fakes do not fail");
    }
    trainer.checkpoint().expect("fakes do not fail")
}

#[test]
fn bytes_bring_everything_back() {
    let checkpoint = some_checkpoint();
    assert_eq!(checkpoint.iteration(), 7);
    assert_eq!(Checkpoint::from_bytes(&checkpoint.to_bytes()).expect("own bytes"), checkpoint);
}

#[test]
fn another_version_is_named() {
    let mut bytes = some_checkpoint().to_bytes();
    bytes[8] += 1;
    assert!(Checkpoint::from_bytes(&bytes).is_err_and(|e| e.to_string().contains("version")));
}

#[test]
fn arrays_must_fit_together() {
    let mut checkpoint = some_checkpoint();
    checkpoint.state.first.means.pop();
    assert!(Checkpoint::from_bytes(&checkpoint.to_bytes()).is_err());
}

#[test]
fn huge_lengths_allocate_nothing() {
    let mut bytes = some_checkpoint().to_bytes();
    // The stack's length, behind options, seed, iteration and round.
    bytes[HEADER + 48..HEADER + 56].copy_from_slice(&u64::MAX.to_le_bytes());
    let checksum = *blake3::hash(&bytes[HEADER..]).as_bytes();
    bytes[20..52].copy_from_slice(&checksum);
    assert!(Checkpoint::from_bytes(&bytes).is_err());
}

proptest! {
    #[test]
    fn damage_is_an_error(at in 0usize..4000, bit in 0u8..8, cut in 0usize..4000) {
        let bytes = some_checkpoint().to_bytes();
        let mut flipped = bytes.clone();
        let at = at % bytes.len();
        flipped[at] ^= 1 << bit;
        prop_assert!(Checkpoint::from_bytes(&flipped).is_err());
        prop_assert!(Checkpoint::from_bytes(&bytes[..cut % bytes.len()]).is_err());
    }

    #[test]
    fn payloads_of_noise_do_not_panic(payload in proptest::collection::vec(any::<u8>(), 0..400)) {
        let mut bytes = Vec::new();
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&(payload.len() as u64).to_le_bytes());
        bytes.extend_from_slice(blake3::hash(&payload).as_bytes());
        bytes.extend_from_slice(&payload);
        prop_assert!(Checkpoint::from_bytes(&bytes).is_err());
    }
}
