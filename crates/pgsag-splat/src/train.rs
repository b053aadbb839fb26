//! When to do what: schedules, density control, neighbours, checkpoints. Names no backend.
