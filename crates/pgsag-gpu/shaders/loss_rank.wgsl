// One group: turns the counts of the blocks into sums of those before, the total after the last.

@group(0) @binding(1) var<storage, read_write> marks: array<u32>;

var<workgroup> sums: array<u32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) thread: u32) {
    let blocks = params.draw.w;
    let run = (blocks + THREADS - 1u) / THREADS;
    let first = blocks_at() + min(thread * run, blocks);
    let last = blocks_at() + min((thread + 1u) * run, blocks);
    var sum = 0u;
    for (var i = first; i < last; i += 1u) {
        sum += marks[i];
    }
    sums[thread] = sum;
    workgroupBarrier();
    var before = 0u;
    for (var i = 0u; i < thread; i += 1u) {
        before += sums[i];
    }
    for (var i = first; i < last; i += 1u) {
        let count = marks[i];
        marks[i] = before;
        before += count;
    }
    if (thread == THREADS - 1u) {
        marks[blocks_at() + blocks] = before;
    }
}
