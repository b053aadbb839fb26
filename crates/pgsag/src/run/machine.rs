//! What the operating system says about this machine and this process. Where it says nothing, the answer is 0 or `None`.

use std::fs;

/// Ticks per second of `/proc/self/stat`: fixed by Linux's user-space interface.
const TICKS_PER_SEC: f64 = 100.0;

/// The machine's name, fit for a file name.
#[must_use]
pub fn host() -> String {
    let name = fs::read_to_string("/proc/sys/kernel/hostname")
        .ok()
        .or_else(|| std::env::var("HOSTNAME").ok())
        .or_else(|| std::env::var("COMPUTERNAME").ok())
        .unwrap_or_default();
    let clean: String =
        name.trim().chars().map(|c| if c.is_ascii_alphanumeric() || c == '.' { c } else { '_' }).collect();
    if clean.is_empty() { "host".into() } else { clean }
}

/// Whether a process of this machine is alive; true where it cannot be known.
#[must_use]
pub fn is_alive(pid: u32) -> bool {
    if !fs::exists("/proc/self").unwrap_or(false) {
        return true;
    }
    match fs::read_to_string(format!("/proc/{pid}/stat")) {
        // A zombie has ended and waits for its parent only.
        Ok(stat) => !stat.rsplit(')').next().is_some_and(|rest| rest.trim_start().starts_with('Z')),
        Err(_) => false,
    }
}

/// Processor seconds of this process, all threads.
#[must_use]
pub fn cpu_secs() -> f64 {
    let Ok(stat) = fs::read_to_string("/proc/self/stat") else { return 0.0 };
    let Some(rest) = stat.rsplit(')').next() else { return 0.0 };
    // Fields 14 and 15 of the whole line; `rest` begins with field 3.
    let ticks: f64 = rest.split_whitespace().skip(11).take(2).filter_map(|field| field.parse::<f64>().ok()).sum();
    ticks / TICKS_PER_SEC
}

/// Most memory that this process held at once since [`reset_peak`], bytes.
#[must_use]
pub fn peak_memory_bytes() -> u64 {
    kib_field("/proc/self/status", "VmHWM:").unwrap_or(0)
}

/// Starts the next [`peak_memory_bytes`] at what is held now.
pub fn reset_peak() {
    // Where it is not allowed the peak is that of the whole process, which is still an upper bound.
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// Memory that can be had without swapping, bytes, inside the limit of the control group.
#[must_use]
pub fn available_memory_bytes() -> Option<u64> {
    let machine = kib_field("/proc/meminfo", "MemAvailable:")?;
    let number = |path: &str| fs::read_to_string(path).ok()?.trim().parse::<u64>().ok();
    let groups = [
        ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
        ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
    ];
    let group = groups.iter().find_map(|(limit, used)| Some(number(limit)?.saturating_sub(number(used)?)));
    Some(group.map_or(machine, |group| group.min(machine)))
}

fn kib_field(path: &str, field: &str) -> Option<u64> {
    let text = fs::read_to_string(path).ok()?;
    let line = text.lines().find(|line| line.starts_with(field))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib * 1024)
}

/// Threads that the machine runs at once.
#[must_use]
pub fn thread_count() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_is_alive_and_process_zero_is_not() {
        assert!(is_alive(std::process::id()));
        if fs::exists("/proc/self").expect("readable") {
            assert!(!is_alive(u32::MAX - 1));
            assert!(peak_memory_bytes() > 0);
            assert!(available_memory_bytes().is_some_and(|bytes| bytes > 0));
        }
    }
}
