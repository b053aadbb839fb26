use super::*;
use pgsag_scene::PixelClass;
use pgsag_scene::numbers::SplitMix64;

fn noise(seed: u64) -> Image {
    let mut random = SplitMix64::new(seed);
    let mut image = Image::filled(40, 30, [0; 3]);
    for pixel in &mut image.pixels {
        *pixel = [0; 3].map(|_: u8| random.below(256) as u8);
    }
    image
}

fn as_render(image: &Image, gain: f32, bias: f32) -> Map<[f32; 3]> {
    let values = image.pixels.iter().map(|p| p.map(|v| gain * f32::from(v) / 255.0 + bias)).collect();
    Map { width: image.width, height: image.height, values }
}

#[test]
fn the_photograph_itself_is_perfect() {
    let image = noise(1);
    let same = image_metrics(&as_render(&image, 1.0, 0.0), &image, None, false);
    assert!(same.psnr > 99.0 && (same.ssim - 1.0).abs() < 1e-6 && same.pixels == 1200);
}

#[test]
fn a_known_error_has_its_known_ratio() {
    let image = Image::filled(20, 20, [100; 3]);
    let off = image_metrics(&as_render(&image, 1.0, 0.1), &image, None, false);
    assert!((off.psnr - 20.0).abs() < 1e-4, "{off:?}");
}

#[test]
fn exposure_is_forgiven_only_when_fitted() {
    let image = noise(2);
    let dim = as_render(&image, 0.5, 0.2);
    assert!(image_metrics(&dim, &image, None, false).psnr < 20.0);
    assert!(image_metrics(&dim, &image, None, true).psnr > 90.0);
    assert!(image_metrics(&as_render(&noise(3), 1.0, 0.0), &image, None, true).ssim < 0.3);
}

#[test]
fn masked_pixels_do_not_count() {
    let image = noise(4);
    let mut render = as_render(&image, 1.0, 0.0);
    let mut mask = Mask::filled(40, 30, PixelClass::Inside);
    for x in 0..40 {
        mask.classes[x] = PixelClass::Occluded;
        render.values[x] = [9.0; 3];
    }
    let masked = image_metrics(&render, &image, Some(&mask), true);
    assert!(masked.psnr > 99.0 && masked.pixels == 1160 && masked.ssim > 0.999);
}
