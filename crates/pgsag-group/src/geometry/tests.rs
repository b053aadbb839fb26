//! Geometry against small scenes made by hand.

use pgsag_scene::numbers::SplitMix64;

use super::*;

const GREY: [u8; 3] = [120, 110, 105];
const LEAF: [u8; 3] = [60, 110, 50];

#[derive(Default)]
struct Place {
    positions: Vec<DVec3>,
    colors: Vec<[u8; 3]>,
    normals: Vec<[f32; 3]>,
}

impl Place {
    fn add(&mut self, at: DVec3, color: [u8; 3], normal: DVec3) {
        self.positions.push(at);
        self.colors.push(color);
        self.normals.push(normal.as_vec3().to_array());
    }

    /// Ground of 60 × 60 m with a house, 10 × 12 × 5 m, where `has_house`, a tree and a car.
    fn new(has_house: bool, leaf: [u8; 3]) -> Self {
        let mut place = Self::default();
        let mut stream = SplitMix64::new(1);
        for i in 0..200 {
            for j in 0..200 {
                let (x, y) = (0.3 * f64::from(i), 0.3 * f64::from(j));
                let is_house = has_house && (20.0..30.0).contains(&x) && (20.0..32.0).contains(&y);
                let is_car = (40.0..44.0).contains(&x) && (10.0..12.0).contains(&y);
                let height = if is_house {
                    5.0
                } else if is_car {
                    1.5
                } else {
                    0.0
                };
                place.add(DVec3::new(x, y, height + 0.03 * stream.normal()), GREY, DVec3::Z);
            }
        }
        for k in 0..17 {
            let z = 0.3 * f64::from(k);
            (0..34).for_each(|j| {
                if has_house {
                    place.add(DVec3::new(20.0, 20.0 + 0.35 * f64::from(j), z), GREY, DVec3::NEG_X)
                }
            });
        }
        for _ in 0..900 {
            let direction = DVec3::new(stream.normal(), stream.normal(), stream.normal().abs()).normalize();
            let bumpy = direction * (3.0 + 0.5 * stream.normal());
            let normal = DVec3::new(stream.normal(), stream.normal(), stream.normal()).normalize();
            place.add(DVec3::new(45.0, 45.0, 4.0) + bumpy, leaf, normal);
        }
        place
    }

    fn found(&self) -> Found {
        let points = Points { positions: &self.positions, colors: &self.colors, normals: &self.normals, spacing: 0.3 };
        find(&points, &PlanFrame::new(DVec3::Z), &GeometryOptions::default(), 1.0).expect("points")
    }
}

#[test]
fn a_house_is_found_and_trees_with_and_without_leaves_are_not() {
    for leaf in [LEAF, GREY] {
        let place = Place::new(true, leaf);
        let found = place.found();
        assert_eq!(found.buildings, 1, "one house");
        let (mut wrong, mut walls) = (0, [0, 0]);
        let feet = place.positions.iter().zip(&place.normals).zip(&found.labels);
        let mut feet = feet.filter(|((at, normal), _)| normal[0] < -0.9 && (0.2..0.4).contains(&at.z) && at.x < 30.0);
        assert!(
            feet.clone().count() > 30 && feet.all(|(_, label)| *label == Label::Building),
            "walls reach the ground"
        );
        for (at, label) in place.positions.iter().zip(&found.labels) {
            let is_house = (20.0..30.0).contains(&at.x) && (20.0..32.0).contains(&at.y);
            if is_house && at.z < 4.5 {
                walls[usize::from(*label == Label::Building)] += 1;
            } else if is_house != (*label == Label::Building) {
                wrong += 1;
            }
        }
        assert!(wrong < 60, "{wrong} points wrong");
        assert!(walls[1] > 5 * walls[0], "walls: {walls:?}");
    }
}

#[test]
fn a_park_has_no_building() {
    for leaf in [LEAF, GREY] {
        let found = Place::new(false, leaf).found();
        assert_eq!((found.buildings, found.others), (0, 1));
        assert!(found.labels.iter().all(|label| *label == Label::Background));
    }
}
