//! Images, masks and instance numbers: JPEG, PNG, TIFF and WebP in; PNG and JPEG out.
//!
//! Orientation tags are ignored, as COLMAP ignores them. 16-bit values are scaled to 8 bits for images, compared with
//! half of the range for masks, and kept for instance numbers. A header is not believed beyond what its bytes can
//! possibly hold, so a damaged file cannot make the decoder ask for memory without end.

use std::io::Cursor;

use image::{DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageFormat, ImageReader, Limits};

use crate::error::{FileError, Place};
use crate::image::Image;
use crate::maps::Map;

/// Decoded bytes that any file may ask for.
const FREE_BYTES: u64 = 16 << 20;
/// Largest ratio of decoded to encoded bytes of the formats (deflate 1 032, LZW about 2 700).
const LARGEST_RATIO: u64 = 3000;
/// WebP can hold one colour in a few bytes; its largest image is 16 383 squared.
const LARGEST_WEBP_BYTES: u64 = 1 << 30;

fn damaged(file: &str, what: &impl ToString) -> FileError {
    FileError::damaged(file, Place::Whole, format!("the image cannot be decoded: {}", what.to_string()))
}

/// The reader of an image, its format known and its memory bounded.
fn reader<'a>(file: &str, bytes: &'a [u8]) -> Result<ImageReader<Cursor<&'a [u8]>>, FileError> {
    let mut reader = ImageReader::new(Cursor::new(bytes));
    let format = image::guess_format(bytes).ok();
    let known = [ImageFormat::Jpeg, ImageFormat::Png, ImageFormat::Tiff, ImageFormat::WebP];
    let Some(format) = format.filter(|format| known.contains(format)) else {
        let cure = "convert it to one of these".into();
        let what = "an image that is neither JPEG, PNG, TIFF nor WebP".into();
        return Err(FileError::Unsupported { file: file.into(), place: Place::Whole, what, cure });
    };
    reader.set_format(format);
    let mut limits = Limits::no_limits();
    let most = FREE_BYTES.saturating_add((bytes.len() as u64).saturating_mul(LARGEST_RATIO));
    limits.max_alloc = Some(if format == ImageFormat::WebP { most.max(LARGEST_WEBP_BYTES) } else { most });
    reader.limits(limits);
    Ok(reader)
}

fn decode(file: &str, bytes: &[u8]) -> Result<DynamicImage, FileError> {
    let image = reader(file, bytes)?.decode().map_err(|error| damaged(file, &error))?;
    if image.width() == 0 || image.height() == 0 {
        return Err(FileError::damaged(file, Place::Whole, "the image has no pixels"));
    }
    Ok(image)
}

/// Decodes an image to 8-bit RGB; grey is repeated, transparency dropped, 16 bits scaled.
///
/// # Errors
/// [`FileError`] where the bytes are no image of a known format.
pub fn decode_image(file: &str, bytes: &[u8]) -> Result<Image, FileError> {
    let image = decode(file, bytes)?.into_rgb8();
    let (width, height) = image.dimensions();
    let pixels = bytemuck::allocation::try_cast_vec(image.into_raw());
    let pixels = pixels.unwrap_or_else(|(_, raw)| bytemuck::cast_slice::<u8, [u8; 3]>(&raw).to_vec());
    Ok(Image { width, height, pixels })
}

/// Width and height in pixels, from the header alone.
///
/// # Errors
/// [`FileError`] where the bytes are no image of a known format.
pub fn image_size(file: &str, bytes: &[u8]) -> Result<(u32, u32), FileError> {
    reader(file, bytes)?.into_dimensions().map_err(|error| damaged(file, &error))
}

/// Decodes a building mask: true where the value (of the first channel) is at least half of the range.
///
/// # Errors
/// [`FileError`] where the bytes are no image of a known format.
pub fn decode_mask(file: &str, bytes: &[u8]) -> Result<Map<bool>, FileError> {
    let image = decode(file, bytes)?;
    let (width, height) = (image.width(), image.height());
    let channels = usize::from(image.color().channel_count());
    let values = match &image {
        DynamicImage::ImageLuma16(_)
        | DynamicImage::ImageLumaA16(_)
        | DynamicImage::ImageRgb16(_)
        | DynamicImage::ImageRgba16(_) => bytemuck::cast_slice(image.as_bytes())
            .chunks_exact(channels)
            .map(|pixel: &[u16]| pixel[0] >= 1 << 15)
            .collect(),
        DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => {
            image.to_rgb8().pixels().map(|pixel| pixel[0] >= 128).collect()
        }
        _ => image.as_bytes().chunks_exact(channels).map(|pixel| pixel[0] >= 128).collect(),
    };
    Ok(Map { width, height, values })
}

/// Decodes instance numbers (0 = none) from a grey image of 8 or 16 bits.
///
/// # Errors
/// [`FileError`] where the bytes are no grey image.
pub fn decode_instances(file: &str, bytes: &[u8]) -> Result<Map<u16>, FileError> {
    let image = decode(file, bytes)?;
    let (width, height) = (image.width(), image.height());
    let values = match image {
        DynamicImage::ImageLuma16(grey) => grey.into_raw(),
        DynamicImage::ImageLuma8(grey) => grey.into_raw().into_iter().map(u16::from).collect(),
        other => {
            let what = format!("instance numbers stored as {:?}", other.color());
            let cure = "store them as grey of 16 bits".into();
            return Err(FileError::Unsupported { file: file.into(), place: Place::Whole, what, cure });
        }
    };
    Ok(Map { width, height, values })
}

fn png(width: u32, height: u32, color: ExtendedColorType, bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut out);
    encoder.write_image(bytes, width, height, color).expect("a map with as many values as pixels, written to memory");
    out
}

/// An image as PNG. Its pixels must be as many as its size says.
#[must_use]
pub fn encode_png(image: &Image) -> Vec<u8> {
    png(image.width, image.height, ExtendedColorType::Rgb8, bytemuck::cast_slice(&image.pixels))
}

/// A building mask as grey PNG, 255 and 0.
#[must_use]
pub fn encode_mask_png(mask: &Map<bool>) -> Vec<u8> {
    let bytes: Vec<u8> = mask.values.iter().map(|&inside| if inside { 255 } else { 0 }).collect();
    png(mask.width, mask.height, ExtendedColorType::L8, &bytes)
}

/// Instance numbers as grey PNG of 16 bits.
#[must_use]
pub fn encode_instances_png(instances: &Map<u16>) -> Vec<u8> {
    png(instances.width, instances.height, ExtendedColorType::L16, bytemuck::cast_slice(&instances.values))
}

/// An image as JPEG, quality 1 to 100. Width and height are at most 65 535.
#[must_use]
pub fn encode_jpeg(image: &Image, quality: u8) -> Vec<u8> {
    let mut out = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut out, quality.clamp(1, 100));
    let bytes: &[u8] = bytemuck::cast_slice(&image.pixels);
    encoder
        .write_image(bytes, image.width, image.height, ExtendedColorType::Rgb8)
        .expect("an image with as many pixels as its size says, written to memory");
    out
}

/// What [`decode_image`] will need at its peak, bytes, from the header alone.
///
/// # Errors
/// [`FileError`] where the bytes are no image of a known format.
pub fn decoded_bytes(file: &str, bytes: &[u8]) -> Result<u64, FileError> {
    let decoder = reader(file, bytes)?.into_decoder().map_err(|error| damaged(file, &error))?;
    let (width, height) = decoder.dimensions();
    Ok(decoder.total_bytes().saturating_add(u64::from(width) * u64::from(height) * 3))
}

#[cfg(test)]
mod tests;
