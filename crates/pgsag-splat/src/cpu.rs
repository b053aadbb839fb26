//! The embedded backend: tiles x lanes x threads, deterministic.
