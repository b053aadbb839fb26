use super::*;

#[test]
fn the_faster_way_stays_until_both_are_timed_again() {
    for (slow, fast) in [(Backward::Pixels, Backward::Gaussians), (Backward::Gaussians, Backward::Pixels)] {
        let mut laps = Laps::default();
        for step in 0..2 * TIMED_EVERY {
            let (way, timed) = laps.next();
            assert_eq!(timed, step % TIMED_EVERY < 2 * TIMED);
            if timed {
                // The slow way is fast at first, before anything is compiled: that does not count.
                let first = step % TIMED_EVERY < 2;
                laps.note(way, Duration::from_millis(if (way == slow) == first { 1 } else { 5 }));
            } else {
                assert_eq!(way, fast, "step {step}, not {slow:?}");
            }
        }
    }
}
