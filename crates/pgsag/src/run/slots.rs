//! Who runs at once: so many jobs, inside the memory of all together, each with a device of its own where there are any.

use std::collections::VecDeque;

use super::execute::Limits;
use super::plan::Order;

/// The slots of one stage.
pub(super) struct Slots {
    limits: Limits,
    count: usize,
    running: usize,
    held_bytes: u64,
    /// Devices that are free, by their number in the run; one that comes back waits at the end.
    devices: VecDeque<usize>,
    device_count: usize,
    /// Jobs that failed once, and on which device.
    failed: Vec<(String, Option<usize>)>,
}

impl Slots {
    /// Slots for so many jobs; without devices they choose for themselves what computes.
    pub(super) fn new(limits: Limits, device_count: usize, jobs: usize) -> Self {
        let wanted = match (device_count, limits.device_jobs) {
            (0, _) => limits.jobs,
            (all, 0) => all,
            (_, typed) => typed,
        };
        // Every device is in turn, some twice where more jobs than devices are asked for.
        let turns = if device_count == 0 { 0 } else { wanted.max(device_count) };
        let devices = (0..turns).map(|turn| turn % device_count).collect();
        let count = wanted.clamp(1, jobs.max(1));
        Self { limits, count, running: 0, held_bytes: 0, devices, device_count, failed: Vec::new() }
    }

    /// Takes a job that may start now out of the list, with what it may use.
    pub(super) fn start<'o>(&mut self, pending: &mut Vec<&'o Order>) -> Option<(&'o Order, Limits)> {
        if self.running >= self.count {
            return None;
        }
        let fits = |order: &Order| {
            self.running == 0 || self.held_bytes + order.plan.cost.memory_bytes <= self.limits.memory_bytes
        };
        let next = pending.iter().position(|order| fits(order) && self.has_device_for(order))?;
        let order = pending.remove(next);
        let device = self.turn_for(order).and_then(|turn| self.devices.remove(turn));
        self.running += 1;
        self.held_bytes += order.plan.cost.memory_bytes;
        let share = Limits {
            jobs: 1,
            memory_bytes: (self.limits.memory_bytes / self.count as u64).max(order.plan.cost.memory_bytes),
            threads: (self.limits.threads / self.count).max(1),
            device,
            ..self.limits
        };
        Some((order, share))
    }

    /// Gives back what a job had.
    pub(super) fn end(&mut self, order: &Order, share: Limits) {
        self.running -= 1;
        self.held_bytes -= order.plan.cost.memory_bytes;
        self.devices.extend(share.device);
    }

    /// Whether nothing runs.
    pub(super) fn is_idle(&self) -> bool {
        self.running == 0
    }

    /// Notes a failure; whether the job had not failed before.
    pub(super) fn is_first_failure(&mut self, order: &Order, share: Limits) -> bool {
        let name = &order.plan.name;
        let is_first = !self.failed.iter().any(|(failed, _)| failed == name);
        self.failed.push((name.clone(), share.device));
        is_first
    }

    fn has_device_for(&self, order: &Order) -> bool {
        self.device_count == 0 || self.turn_for(order).is_some()
    }

    /// Place of a free device on which the job has not failed; where there is but one, that.
    fn turn_for(&self, order: &Order) -> Option<usize> {
        let has_failed = |device: usize| self.failed.contains(&(order.plan.name.clone(), Some(device)));
        self.devices.iter().position(|&device| self.device_count == 1 || !has_failed(device))
    }
}
