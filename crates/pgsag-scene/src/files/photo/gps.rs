//! Latitude, longitude and altitude from EXIF and from DJI's XMP packet.

use exif::{In, Tag, Value};

/// A place on Earth, WGS 84.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gps {
    /// Degrees, north positive.
    pub latitude_deg: f64,
    /// Degrees, east positive.
    pub longitude_deg: f64,
    /// Metres, in the camera's own vertical datum.
    pub altitude_m: f64,
}

impl Gps {
    /// A place; `None` where the numbers are not on Earth, or are the (0, 0) of a receiver without a fix.
    #[must_use]
    pub fn new(latitude_deg: f64, longitude_deg: f64, altitude_m: f64) -> Option<Self> {
        let on_earth = latitude_deg.abs() <= 90.0 && longitude_deg.abs() <= 180.0 && altitude_m.abs() < 1e5;
        let fixed = latitude_deg != 0.0 || longitude_deg != 0.0;
        (on_earth && fixed).then_some(Self { latitude_deg, longitude_deg, altitude_m })
    }
}

/// Orientation and place from an EXIF block (TIFF structure).
#[must_use]
pub fn parse_exif(block: Vec<u8>) -> (Option<u32>, Option<Gps>) {
    let Ok(exif) = exif::Reader::new().read_raw(block) else {
        return (None, None);
    };
    let value = |tag: Tag| exif.get_field(tag, In::PRIMARY).map(|field| &field.value);
    let orientation = value(Tag::Orientation).and_then(|value| value.get_uint(0));
    let letter = |tag: Tag| match value(tag) {
        Some(Value::Ascii(words)) => words.first().and_then(|word| word.first()).map(u8::to_ascii_uppercase),
        _ => None,
    };
    let degrees = |tag: Tag| match value(tag) {
        Some(Value::Rational(parts)) if !parts.is_empty() => {
            let sixtieths = [1.0, 60.0, 3600.0];
            let sum: f64 = parts.iter().zip(sixtieths).map(|(part, unit)| part.to_f64() / unit).sum();
            sum.is_finite().then_some(sum)
        }
        _ => None,
    };
    let place = || {
        let south = letter(Tag::GPSLatitudeRef) == Some(b'S');
        let west = letter(Tag::GPSLongitudeRef) == Some(b'W');
        let below = value(Tag::GPSAltitudeRef).and_then(|value| value.get_uint(0)) == Some(1);
        let signed = |value: f64, negative: bool| if negative { -value } else { value };
        let altitude = match value(Tag::GPSAltitude) {
            Some(Value::Rational(parts)) => parts.first().map(|part| part.to_f64()).filter(|v| v.is_finite()),
            _ => None,
        };
        Gps::new(
            signed(degrees(Tag::GPSLatitude)?, south),
            signed(degrees(Tag::GPSLongitude)?, west),
            signed(altitude.unwrap_or(0.0), below),
        )
    };
    (orientation, place())
}

/// Place from an XMP packet with DJI's names (`drone-dji:GpsLatitude` …), as attributes or elements.
#[must_use]
pub fn parse_xmp(packet: &[u8]) -> Option<Gps> {
    use quick_xml::events::Event;
    let text = std::str::from_utf8(packet).ok()?;
    let mut reader = quick_xml::Reader::from_str(text);
    let (mut latitude, mut longitude, mut altitude) = (None::<f64>, None::<f64>, None::<f64>);
    let mut open = String::new();
    let mut note = |name: &str, value: &str| {
        let number = value.trim().parse::<f64>().ok();
        match name.rsplit(':').next().unwrap_or(name) {
            "GpsLatitude" => latitude = number.or(latitude),
            "GpsLongitude" | "GpsLongtitude" => longitude = number.or(longitude),
            "AbsoluteAltitude" => altitude = number.or(altitude),
            _ => {}
        }
    };
    loop {
        match reader.read_event() {
            Ok(Event::Start(tag) | Event::Empty(tag)) => {
                for attribute in tag.attributes().flatten() {
                    note(attribute.key.as_ref(), &attribute.value);
                }
                open = tag.name().as_ref().to_owned();
            }
            Ok(Event::Text(words)) => note(&open, &words),
            Ok(Event::Eof) | Err(_) => break,
            Ok(_) => {}
        }
    }
    Gps::new(latitude?, longitude?, altitude.unwrap_or(0.0))
}
