//! What a photograph says about itself before it is decoded: size, orientation tag, place on Earth.
//!
//! JPEG files are walked segment by segment up to the frame header, so that no pixel is read; the other formats go
//! through the header of their decoder. EXIF GPS comes first; the XMP packet of DJI drones is asked where it is absent.

use std::io::{BufRead, Seek, SeekFrom};

use image::{ImageDecoder, ImageReader};

use crate::error::{FileError, Place};

mod gps;

pub use gps::{Gps, parse_exif, parse_xmp};

/// The header of a photograph.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PhotoHeader {
    /// Pixels, as stored (the orientation tag is not applied).
    pub width: u32,
    /// Pixels, as stored.
    pub height: u32,
    /// EXIF orientation, 1 = upright; `None` where it is not said.
    pub orientation: Option<u32>,
    /// Where it was taken.
    pub gps: Option<Gps>,
}

/// Reads the header of a photograph.
///
/// # Errors
/// [`FileError`] where the size cannot be found. Damaged EXIF or XMP counts as absent.
pub fn read_header(file: &str, reader: &mut (impl BufRead + Seek)) -> Result<PhotoHeader, FileError> {
    let start = reader.fill_buf().map_err(|error| unreadable(file, &error))?;
    if start.starts_with(&[0xFF, 0xD8]) { jpeg_header(file, reader) } else { other_header(file, reader) }
}

fn unreadable(file: &str, error: &std::io::Error) -> FileError {
    match error.kind() {
        std::io::ErrorKind::UnexpectedEof => FileError::damaged(file, Place::Whole, "the image ends within its header"),
        _ => FileError::Unreadable { file: file.into(), reason: error.to_string() },
    }
}

fn other_header(file: &str, reader: &mut (impl BufRead + Seek)) -> Result<PhotoHeader, FileError> {
    let damaged = |error: &dyn std::fmt::Display| FileError::damaged(file, Place::Whole, format!("no image: {error}"));
    let decoder = ImageReader::new(reader).with_guessed_format().map_err(|error| unreadable(file, &error))?;
    let mut decoder = decoder.into_decoder().map_err(|error| damaged(&error))?;
    let (width, height) = decoder.dimensions();
    let (orientation, mut gps) = decoder.exif_metadata().ok().flatten().map(parse_exif).unwrap_or_default();
    if gps.is_none() {
        gps = decoder.xmp_metadata().ok().flatten().and_then(|packet| parse_xmp(&packet));
    }
    Ok(PhotoHeader { width, height, orientation, gps })
}

fn jpeg_header(file: &str, reader: &mut (impl BufRead + Seek)) -> Result<PhotoHeader, FileError> {
    const EXIF: &[u8] = b"Exif\0\0";
    const XMP: &[u8] = b"http://ns.adobe.com/xap/1.0/\0";
    let mut header = PhotoHeader::default();
    let mut xmp_gps = None;
    let mut marker = [0; 2];
    let mut length = [0; 2];
    reader.read_exact(&mut marker).map_err(|error| unreadable(file, &error))?;
    loop {
        reader.read_exact(&mut marker).map_err(|error| unreadable(file, &error))?;
        while marker[1] == 0xFF {
            reader.read_exact(&mut marker[1..]).map_err(|error| unreadable(file, &error))?;
        }
        reader.read_exact(&mut length).map_err(|error| unreadable(file, &error))?;
        let len = usize::from(u16::from_be_bytes(length));
        if marker[0] != 0xFF || len < 2 || marker[1] == 0xDA {
            return Err(FileError::damaged(file, Place::Whole, "the JPEG file has no frame header"));
        }
        let is_frame = matches!(marker[1], 0xC0..=0xCF) && ![0xC4, 0xC8, 0xCC].contains(&marker[1]);
        if !is_frame && marker[1] != 0xE1 {
            reader.seek(SeekFrom::Current(len as i64 - 2)).map_err(|error| unreadable(file, &error))?;
            continue;
        }
        let mut segment = vec![0; len - 2];
        reader.read_exact(&mut segment).map_err(|error| unreadable(file, &error))?;
        if let Some(exif) = segment.strip_prefix(EXIF) {
            (header.orientation, header.gps) = parse_exif(exif.to_vec());
        } else if let Some(packet) = segment.strip_prefix(XMP) {
            xmp_gps = parse_xmp(packet);
        }
        if let (true, [_, h1, h0, w1, w0, ..]) = (is_frame, segment.as_slice()) {
            header.height = u32::from(u16::from_be_bytes([*h1, *h0]));
            header.width = u32::from(u16::from_be_bytes([*w1, *w0]));
            header.gps = header.gps.or(xmp_gps);
            return Ok(header);
        }
    }
}

#[cfg(test)]
mod tests;
