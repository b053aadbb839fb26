//! Removing lens distortion: the target pinhole and the resampling of an image into it.
