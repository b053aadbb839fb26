//! The suite that any `Backend` must pass.
