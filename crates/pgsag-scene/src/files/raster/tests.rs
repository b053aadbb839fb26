use super::*;
use image::{ImageBuffer, Luma, Rgb};

fn gradient() -> Image {
    let pixels = (0..35u8).map(|i| [i * 7, 255 - i, i]).collect();
    Image { width: 7, height: 5, pixels }
}

fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    image.write_to(&mut out, format).unwrap();
    out.into_inner()
}

#[test]
fn png_is_exact_and_jpeg_is_close() {
    let image = gradient();
    assert_eq!(decode_image("a.png", &encode_png(&image)).unwrap(), image);
    let flat = Image::filled(33, 17, [120, 60, 200]);
    let back = decode_image("a.jpg", &encode_jpeg(&flat, 95)).unwrap();
    assert!(back.pixels.iter().flatten().zip(flat.pixels.iter().flatten()).all(|(a, b)| a.abs_diff(*b) <= 2));
    assert_eq!(image_size("a.jpg", &encode_jpeg(&flat, 95)).unwrap(), (33, 17));
    assert_eq!(decoded_bytes("a.jpg", &encode_jpeg(&flat, 95)).unwrap(), 2 * 3 * 33 * 17);
}

#[test]
fn sixteen_bits_are_scaled() {
    let deep: ImageBuffer<Rgb<u16>, Vec<u16>> = ImageBuffer::from_pixel(4, 3, Rgb([65535, 32768, 257]));
    for format in [ImageFormat::Png, ImageFormat::Tiff] {
        let image = decode_image("a.tif", &encoded(&deep.clone().into(), format)).unwrap();
        assert_eq!(image, Image::filled(4, 3, [255, 128, 1]));
    }
}

#[test]
fn tiff_and_webp_are_read() {
    let image = gradient();
    let raw = ImageBuffer::from_raw(7, 5, bytemuck::cast_slice(&image.pixels).to_vec()).unwrap();
    for format in [ImageFormat::Tiff, ImageFormat::WebP] {
        assert_eq!(decode_image("a", &encoded(&DynamicImage::ImageRgb8(raw.clone()), format)).unwrap(), image);
    }
}

#[test]
fn masks_are_cut_at_half_of_the_range() {
    let mask = Map { width: 3, height: 1, values: vec![false, true, true] };
    assert_eq!(decode_mask("m.png", &encode_mask_png(&mask)).unwrap(), mask);
    let shallow: ImageBuffer<Luma<u8>, Vec<u8>> = ImageBuffer::from_raw(3, 1, vec![127, 128, 255]).unwrap();
    assert_eq!(decode_mask("m.png", &encoded(&shallow.into(), ImageFormat::Png)).unwrap(), mask);
    let deep: ImageBuffer<Luma<u16>, Vec<u16>> = ImageBuffer::from_raw(3, 1, vec![32767, 32768, 65535]).unwrap();
    assert_eq!(decode_mask("m.png", &encoded(&deep.into(), ImageFormat::Png)).unwrap(), mask);
    let color: ImageBuffer<Rgb<u8>, Vec<u8>> =
        ImageBuffer::from_raw(3, 1, vec![0, 255, 255, 128, 0, 0, 255, 0, 0]).unwrap();
    assert_eq!(decode_mask("m.png", &encoded(&color.into(), ImageFormat::Png)).unwrap(), mask);
}

#[test]
fn instances_keep_sixteen_bits() {
    let map = Map { width: 2, height: 2, values: vec![0, 1, 300, 65535] };
    assert_eq!(decode_instances("i.png", &encode_instances_png(&map)).unwrap(), map);
    let error = decode_instances("i.png", &encode_png(&gradient())).unwrap_err().to_string();
    assert!(error.starts_with("i.png: instance numbers stored as Rgb8 is not supported"), "{error}");
}

#[test]
fn a_header_that_promises_too_much_is_refused() {
    let mut png = encode_mask_png(&Map::filled(8, 8, true));
    png[16..24].copy_from_slice(&[0, 0, 0xFF, 0xFF, 0, 0, 0xFF, 0xFF]);
    let crc = png[12..29].iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 })
    });
    png[29..33].copy_from_slice(&(!crc).to_be_bytes());
    assert_eq!(image_size("m.png", &png).unwrap(), (65535, 65535));
    let error = decode_image("m.png", &png).unwrap_err().to_string();
    assert!(error.contains("m.png") && error.contains("imit"), "{error}");
}

#[test]
fn other_formats_are_refused_by_name() {
    let error = decode_image("a.gif", b"GIF89a....").unwrap_err().to_string();
    assert_eq!(
        error,
        "a.gif: an image that is neither JPEG, PNG, TIFF nor WebP is not supported; convert it to one of these"
    );
}
