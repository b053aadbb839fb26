// A stable radix sort, eight bits a pass. A block is GROUP * EACH values; within it every subgroup has a run of them.

override GROUP: u32 = 256u;
// Lowest bit of the digit.
override SHIFT: u32 = 0u;
// Place of the count in `sizes`.
override COUNT: u32 = 1u;
const EACH: u32 = 8u;
const DIGITS: u32 = 256u;

fn digit_of(key: u32) -> u32 {
    return (key >> SHIFT) & (DIGITS - 1u);
}

fn block_count(count: u32) -> u32 {
    return (count + GROUP * EACH - 1u) / (GROUP * EACH);
}
