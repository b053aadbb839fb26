//! CPU clocks, and how fast this processor multiplies and adds: the two things that figures of speed stand on.
//! CPU time and not time on the wall: a machine that does other things at once must not change the figures.

use fearless_simd::{Level, Simd, prelude::*};

/// CPU time of the calling thread, milliseconds.
#[cfg(unix)]
pub(crate) fn thread_ms() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 * 1e-6
}

/// Time on the wall, milliseconds, where there is no clock of CPU time.
#[cfg(not(unix))]
pub(crate) fn thread_ms() -> f64 {
    wall_ms()
}

/// Time on the wall since some moment, milliseconds.
pub(crate) fn wall_ms() -> f64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    START.get_or_init(std::time::Instant::now).elapsed().as_secs_f64() * 1e3
}

/// Independent chains, enough to hide the latency of every processor of today.
const CHAINS: usize = 12;
const ROUNDS: usize = 200_000;

#[inline(always)]
fn multiply_and_add<S: Simd>(simd: S, seed: f32) -> (f32, usize) {
    let (factor, term) = (S::f32s::splat(simd, 0.999), S::f32s::splat(simd, seed));
    // Each chain is another, or a compiler makes one of them all.
    let mut chains = std::array::from_fn::<_, CHAINS, _>(|k| S::f32s::splat(simd, seed * k as f32));
    for _ in 0..ROUNDS {
        for chain in &mut chains {
            *chain = chain.mul_add(factor, term);
        }
    }
    let mut lanes = [0.0; 16];
    let mut sum = 0.0;
    for chain in chains {
        chain.store_slice(&mut lanes[..S::f32s::LEN]);
        sum += lanes[0];
    }
    (sum, S::f32s::LEN)
}

/// Fused multiply-adds of one core, best vector level, 2 operations each: 10⁹ operations per CPU second.
pub(crate) fn fma_gflops() -> f64 {
    let start = thread_ms();
    let (sum, lanes) =
        fearless_simd::dispatch!(Level::new(), simd => multiply_and_add(simd, std::hint::black_box(1e-3)));
    std::hint::black_box(sum);
    let operations = 2 * CHAINS * ROUNDS * lanes;
    operations as f64 * 1e-6 / (thread_ms() - start)
}

/// The most memory that this process has held, MiB; `None` where the system does not tell.
pub(crate) fn peak_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.split_ascii_whitespace().next()?.parse::<f64>().ok().map(|kib| kib / 1024.0)
}
