//! Maps of 32-bit floats as files (`.depth`, `.normal`): exact, checked, and read without parsing.
//!
//! Layout, little-endian: magic `PGSAGMAP`, `u32` version (1), `u32` width, height, channels, then
//! `height * width * channels` values `f32`, row-major, channels together.

use crate::error::{FileError, Place};
use crate::files::cursor::Cursor;
use crate::maps::Map;

const MAGIC: &[u8; 8] = b"PGSAGMAP";
const VERSION: u32 = 1;

/// A map's value made of 32-bit floats.
pub trait FloatSample: bytemuck::Pod {
    /// How many floats a pixel has.
    const CHANNELS: u32;
}

impl FloatSample for f32 {
    const CHANNELS: u32 = 1;
}
impl FloatSample for [f32; 2] {
    const CHANNELS: u32 = 2;
}
impl FloatSample for [f32; 3] {
    const CHANNELS: u32 = 3;
}
impl FloatSample for [f32; 4] {
    const CHANNELS: u32 = 4;
}

/// The file of a map.
#[must_use]
pub fn encode_map<T: FloatSample>(map: &Map<T>) -> Vec<u8> {
    let values: &[f32] = bytemuck::cast_slice(&map.values);
    let mut out = Vec::with_capacity(24 + 4 * values.len());
    out.extend(MAGIC);
    [VERSION, map.width, map.height, T::CHANNELS].iter().for_each(|number| out.extend(number.to_le_bytes()));
    values.iter().for_each(|value| out.extend(value.to_le_bytes()));
    out
}

/// Reads the file of a map.
///
/// # Errors
/// [`FileError`]: no such file, another version, another number of channels, too short or too long.
pub fn decode_map<T: FloatSample>(file: &str, bytes: &[u8]) -> Result<Map<T>, FileError> {
    let mut cursor = Cursor::new(file, bytes);
    if cursor.slice(MAGIC.len())? != MAGIC {
        return Err(FileError::damaged(file, Place::Byte(0), "not a map: it does not begin with PGSAGMAP"));
    }
    let version = cursor.u32()?;
    if version != VERSION {
        let (what, cure) = (format!("version {version} of the map format"), "delete the run's cache".into());
        return Err(FileError::Unsupported { file: file.into(), place: Place::Byte(8), what, cure });
    }
    let (width, height, channels) = (cursor.u32()?, cursor.u32()?, cursor.u32()?);
    if channels != T::CHANNELS {
        return Err(cursor.error(format!("{channels} channels instead of {}", T::CHANNELS)));
    }
    let pixels = u128::from(width) * u128::from(height);
    if pixels * 4 * u128::from(channels) != cursor.remaining() as u128 {
        let have = cursor.remaining();
        return Err(cursor.error(format!("{width} x {height} x {channels} values do not make {have} bytes")));
    }
    let mut values = vec![T::zeroed(); pixels as usize];
    let floats: &mut [f32] = bytemuck::cast_slice_mut(&mut values);
    for (value, raw) in floats.iter_mut().zip(cursor.slice(cursor.remaining())?.chunks_exact(4)) {
        *value = f32::from_le_bytes([raw[0], raw[1], raw[2], raw[3]]);
    }
    Ok(Map { width, height, values })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_survives_its_file() {
        let map = Map {
            width: 3,
            height: 2,
            values: vec![[1.0, f32::NAN, -0.0], [0.1; 3], [2.0; 3], [3.0; 3], [4.0; 3], [5.0; 3]],
        };
        let bytes = encode_map(&map);
        let back: Map<[f32; 3]> = decode_map("a.normal", &bytes).unwrap();
        assert_eq!(bytemuck::cast_slice::<_, u8>(&back.values), bytemuck::cast_slice::<_, u8>(&map.values));
        assert!(decode_map::<f32>("a.normal", &bytes).unwrap_err().to_string().contains("3 channels"));
        for len in 0..bytes.len() {
            assert!(decode_map::<[f32; 3]>("a.normal", &bytes[..len]).unwrap_err().to_string().contains("a.normal"));
        }
    }
}
