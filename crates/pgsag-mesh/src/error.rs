//! What can go wrong with values handed to this crate.

/// A refusal, with its cure.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// Rasters that must have the size of their camera do not.
    #[error("{what} is {found_width} x {found_height} px but its camera is {width} x {height} px: resize one of them")]
    Size {
        /// Which raster.
        what: &'static str,
        /// Camera, pixels.
        width: u32,
        /// Camera, pixels.
        height: u32,
        /// Raster, pixels.
        found_width: u32,
        /// Raster, pixels.
        found_height: u32,
    },
    /// A number outside of what it may be.
    #[error("{name} = {value}: must be {allowed}")]
    Option {
        /// The option.
        name: &'static str,
        /// What was given.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The volume would not fit.
    #[error(
        "the volume needs {needed_bytes} bytes but may use {max_bytes}: use smaller cubes, larger voxels or more memory"
    )]
    Memory {
        /// Bytes that the blocks would take.
        needed_bytes: u64,
        /// Bytes allowed.
        max_bytes: u64,
    },
    /// A mesh or cloud that cannot be judged or worked on.
    #[error("{what}: {cure}")]
    Geometry {
        /// What is wrong.
        what: String,
        /// What to do.
        cure: &'static str,
    },
}
