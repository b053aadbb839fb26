use super::*;
use std::io::Cursor;

/// A TIFF block with orientation 6 and a place: 46° 50' 33.6" N, 91° 59' 40.2" W, 198.3 m.
pub(crate) fn exif_block() -> Vec<u8> {
    let mut out = b"II*\0".to_vec();
    let u16s = |out: &mut Vec<u8>, values: &[u16]| values.iter().for_each(|v| out.extend(v.to_le_bytes()));
    let entry = |out: &mut Vec<u8>, tag: u16, kind: u16, count: u32, value: [u8; 4]| {
        u16s(out, &[tag, kind]);
        out.extend(count.to_le_bytes());
        out.extend(value);
    };
    out.extend(8u32.to_le_bytes());
    u16s(&mut out, &[2]);
    entry(&mut out, 0x0112, 3, 1, [6, 0, 0, 0]);
    entry(&mut out, 0x8825, 4, 1, 38u32.to_le_bytes());
    out.extend([0; 4]);
    assert_eq!(out.len(), 38);
    u16s(&mut out, &[6]);
    let data = 38 + 2 + 6 * 12 + 4u32;
    entry(&mut out, 1, 2, 2, *b"N\0\0\0");
    entry(&mut out, 2, 5, 3, data.to_le_bytes());
    entry(&mut out, 3, 2, 2, *b"W\0\0\0");
    entry(&mut out, 4, 5, 3, (data + 24).to_le_bytes());
    entry(&mut out, 5, 1, 1, [0; 4]);
    entry(&mut out, 6, 5, 1, (data + 48).to_le_bytes());
    out.extend([0; 4]);
    for (top, bottom) in [(46u32, 1u32), (50, 1), (336, 10), (91, 1), (59, 1), (402, 10), (1983, 10)] {
        out.extend(top.to_le_bytes());
        out.extend(bottom.to_le_bytes());
    }
    out
}

/// A JPEG of 33 x 17 with segments put before the frame.
pub(crate) fn jpeg_with(segments: &[(&[u8], &[u8])]) -> Vec<u8> {
    let jpeg = crate::files::raster::encode_jpeg(&crate::Image::filled(33, 17, [9; 3]), 90);
    let mut out = jpeg[..2].to_vec();
    for (name, body) in segments {
        out.extend([0xFF, 0xE1]);
        out.extend(((name.len() + body.len() + 2) as u16).to_be_bytes());
        out.extend(*name);
        out.extend(*body);
    }
    out.extend(&jpeg[2..]);
    out
}

const XMP: &[u8] = br#"<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description drone-dji:AbsoluteAltitude="+12.50"
 drone-dji:GpsLatitude="-33.5" drone-dji:GpsLongtitude="+151.25"/></x:xmpmeta>"#;

#[test]
fn exif_of_a_jpeg() {
    let jpeg = jpeg_with(&[(b"Exif\0\0", &exif_block())]);
    let header = read_header("a.jpg", &mut Cursor::new(&jpeg)).unwrap();
    assert_eq!((header.width, header.height, header.orientation), (33, 17, Some(6)));
    let gps = header.gps.unwrap();
    assert!((gps.latitude_deg - 46.842_666_666).abs() < 1e-8, "{gps:?}");
    assert!((gps.longitude_deg + 91.994_5).abs() < 1e-8, "{gps:?}");
    assert!((gps.altitude_m - 198.3).abs() < 1e-9, "{gps:?}");
}

#[test]
fn xmp_where_there_is_no_exif() {
    let jpeg = jpeg_with(&[(b"http://ns.adobe.com/xap/1.0/\0", XMP)]);
    let header = read_header("a.jpg", &mut Cursor::new(&jpeg)).unwrap();
    assert_eq!(header.gps, Gps::new(-33.5, 151.25, 12.5));
    let elements = b"<d><drone-dji:GpsLatitude>1.5</drone-dji:GpsLatitude><a:GpsLongitude>2</a:GpsLongitude></d>";
    assert_eq!(parse_xmp(elements), Gps::new(1.5, 2.0, 0.0));
}

#[test]
fn sizes_of_the_other_formats() {
    let png = crate::files::raster::encode_png(&crate::Image::filled(5, 6, [1; 3]));
    let header = read_header("a.png", &mut Cursor::new(&png)).unwrap();
    assert_eq!(header, PhotoHeader { width: 5, height: 6, ..PhotoHeader::default() });
}

#[test]
fn a_place_without_a_fix_is_no_place() {
    assert_eq!(Gps::new(0.0, 0.0, 5.0), None);
    assert_eq!(Gps::new(f64::NAN, 1.0, 5.0), None);
    assert_eq!(Gps::new(91.0, 1.0, 5.0), None);
}

#[test]
fn truncated_headers_are_errors() {
    let jpeg = jpeg_with(&[(b"Exif\0\0", &exif_block())]);
    for len in 0..160 {
        let error = read_header("a.jpg", &mut Cursor::new(&jpeg[..len])).unwrap_err().to_string();
        assert!(error.contains("a.jpg"), "{error}");
    }
}
