//! The embedded backend.
mod backward;
mod bins;
mod forward;
mod lanes;
mod layout;
mod sort;
