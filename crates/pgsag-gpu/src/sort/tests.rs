use bytemuck::Zeroable;
use pgsag_scene::numbers::SplitMix64;

use super::*;
use crate::render::FrameUniform;
use crate::tests::device;

/// Counts around the borders of blocks, and a few blocks.
fn counts(device: &Device) -> Vec<usize> {
    let block = device.group() as usize * EACH as usize;
    vec![0, 1, block - 1, block, block + 1, 3 * block + 17, 11 * block]
}

/// Counters of so many values, launches included, as `scan_spine.wgsl` writes them.
fn counters(device: &Device, counted: Counted, count: usize) -> Counters {
    let counters = Counters::new(device).expect("memory");
    let blocks = (count as u32).div_ceil(device.group() * EACH as u32);
    device.write(&counters.sizes, 4 * counted as u64, &[count as u32]);
    let launches = [(count as u32).div_ceil(256), 1, 1, blocks, 1, 1];
    device.write(&counters.launches, 24 * (counted as u64 - 1), &launches);
    counters
}

/// A frame that says nothing but how many pairs there is room for.
fn room_for(pairs: u32) -> FrameUniform {
    let mut frame = FrameUniform::zeroed();
    frame.pairs = pairs;
    frame
}

#[test]
fn the_order_is_that_of_a_stable_sort() {
    let Some(device) = device() else { return };
    let mut stream = SplitMix64::new(3);
    for count in counts(device) {
        for (bits, spread) in [(1, 2), (8, 256), (11, 1800), (32, usize::MAX)] {
            let keys: Vec<u32> = (0..count).map(|_| stream.below(spread) as u32).collect();
            let mut expected: Vec<u32> = (0..count as u32).collect();
            expected.sort_by_key(|&i| keys[i as usize]);
            let counters = counters(device, Counted::Pairs, count);
            let buffer = Arc::new(device.buffer_with("keys", &keys).expect("memory"));
            let mut record = device.record("test");
            // There is room for more than there is.
            let room = count as u64 + 100;
            let sorted = sort(device, &mut record, &counters, (Counted::Pairs, room), &buffer, bits).expect("memory");
            record.submit();
            let values: Vec<u32> = device.read(&sorted[1], 0, count).expect("values");
            assert_eq!(values, expected, "{count} keys of {bits} bits");
            let sorted_keys: Vec<u32> = device.read(&sorted[0], 0, count).expect("keys");
            assert!(sorted_keys.is_sorted(), "{count} keys of {bits} bits");
        }
    }
}

#[test]
fn sums_are_those_before_and_their_total_is_launched() {
    let Some(device) = device() else { return };
    let mut stream = SplitMix64::new(5);
    for count in counts(device).into_iter().filter(|&count| count > 0) {
        let values: Vec<u32> = (0..count).map(|_| stream.below(4) as u32).collect();
        let order: Vec<u32> = (0..count as u32).rev().collect();
        let flags: Vec<u32> = values.iter().map(|&value| value.min(1)).collect();
        let gathered: Vec<u32> = order.iter().map(|&i| values[i as usize]).collect();
        for (counted, added) in [(Counted::Drawn, flags), (Counted::Pairs, gathered)] {
            // Of Gaussians the host knows the number, of those drawn the card does.
            let counters = counters(device, Counted::Drawn, count);
            let known = [count as u32, count as u32];
            device.write(&counters.sizes, 0, &known);
            let frame = device.uniform(&room_for(u32::MAX)).expect("memory");
            let [values, order] = [&values, &order].map(|list| device.buffer_with("values", list).expect("memory"));
            let mut record = device.record("test");
            let what = (counted, count as u64);
            let prefixes = scan(device, &mut record, &counters, &frame, what, [&values, &order]).expect("memory");
            record.submit();
            let found: Vec<u32> = device.read(&prefixes, 0, count).expect("sums");
            let mut sum = 0;
            for (i, value) in added.iter().enumerate() {
                assert_eq!(found[i], sum, "{counted:?}, value {i} of {count}");
                sum += value;
            }
            let total: Vec<u32> = device.read(&counters.sizes, 4 * counted as u64, 1).expect("total");
            assert_eq!(total, [sum], "{counted:?} of {count}");
            let launch: Vec<u32> = device.read(&counters.launches, 24 * (counted as u64 - 1), 3).expect("launch");
            assert_eq!(launch, [sum.div_ceil(256), u32::from(sum > 0), u32::from(true)], "{counted:?} of {count}");
        }
    }
}

#[test]
fn what_there_is_no_room_for_is_told() {
    let Some(device) = device() else { return };
    let counters = counters(device, Counted::Drawn, 3);
    let frame = device.uniform(&room_for(10)).expect("memory");
    let values = device.buffer_with("values", &[7u32, 2, 4]).expect("memory");
    let order = device.buffer_with("values", &[2u32, 0, 1]).expect("memory");
    let mut record = device.record("test");
    scan(device, &mut record, &counters, &frame, (Counted::Pairs, 3), [&values, &order]).expect("memory");
    record.submit();
    let sizes: Vec<u32> = device.read(&counters.sizes, 8, 2).expect("sizes");
    assert_eq!(sizes, [10, 13]);
}
