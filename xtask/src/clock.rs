//! Wall time and the CPU time of every process that was started and waited for.

use std::time::Instant;

/// Seconds of the clock on the wall and of all cores together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Spent {
    pub(crate) wall_secs: f64,
    /// `None` where the system does not tell (`/proc` is Linux).
    pub(crate) cpu_secs: Option<f64>,
}

/// A running measurement.
pub(crate) struct Clock {
    start: Instant,
    cpu_start_secs: Option<f64>,
}

impl Clock {
    pub(crate) fn start() -> Self {
        Self { start: Instant::now(), cpu_start_secs: children_cpu_secs() }
    }

    pub(crate) fn stop(&self) -> Spent {
        let cpu_secs = children_cpu_secs().zip(self.cpu_start_secs).map(|(now, then)| now - then);
        Spent { wall_secs: self.start.elapsed().as_secs_f64(), cpu_secs }
    }
}

impl std::fmt::Display for Spent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:7.1} s wall", self.wall_secs)?;
        self.cpu_secs.map_or(Ok(()), |secs| write!(f, "  {secs:7.1} s cpu"))
    }
}

fn children_cpu_secs() -> Option<f64> {
    parse_children_cpu_secs(&std::fs::read_to_string("/proc/self/stat").ok()?)
}

/// Fields 16 and 17 of proc(5) `stat`, in ticks of 1/100 s (Linux fixes the tick that user space sees).
fn parse_children_cpu_secs(stat: &str) -> Option<f64> {
    const TICKS_PER_SEC: f64 = 100.0;
    let after_name = stat.rsplit_once(')')?.1;
    let mut fields = after_name.split_whitespace().skip(13);
    let user: f64 = fields.next()?.parse().ok()?;
    let system: f64 = fields.next()?.parse().ok()?;
    Some((user + system) / TICKS_PER_SEC)
}

#[cfg(test)]
mod tests {
    use super::parse_children_cpu_secs;

    #[test]
    fn reads_children_time_behind_an_odd_process_name() {
        let stat = "7 (x) y (z) S 1 2 3 4 5 6 7 8 9 10 11 12 250 50 20 0 1";
        assert_eq!(parse_children_cpu_secs(stat), Some(3.0));
    }

    #[test]
    fn a_truncated_line_is_none() {
        assert_eq!(parse_children_cpu_secs("7 (x) S 1 2"), None);
    }
}
