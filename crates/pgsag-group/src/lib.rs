//! Which pixels and points are which building: the paper's section 4.1.
