//! The terms of Eq. 10-11, one file each.
