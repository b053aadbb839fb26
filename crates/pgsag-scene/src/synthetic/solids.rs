//! From the plan to triangles: closed solids with shared vertices, each flat piece a surface with its own texture frame.
//! Frame: metres about the middle of the town, z up, ground at z = 0. Solids reach below the ground, so nothing leaks.

use glam::{DVec2, DVec3};

use super::layout::{Car, House, Layout, Tree};
use super::texture::hash;

/// How far the solids reach below the ground, metres.
const CELLAR: f64 = 0.3;
/// The ground ends this far outside the town, metres.
const COUNTRYSIDE: f64 = 160.0;

/// What a surface is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Material {
    Ground,
    /// Bricks or plaster with windows and doors.
    Wall,
    Tiles,
    Gravel,
    /// Chimneys and roof boxes: masonry without windows.
    Masonry,
    Crown,
    Trunk,
    Car,
}

/// A flat piece of a solid, or a whole crown.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    pub material: Material,
    /// Building number; 0 = none.
    pub building: u32,
    /// Texture frame: along, up, out. For a crown `origin` is its centre and the axes are the world's.
    pub origin: DVec3,
    pub u: DVec3,
    pub v: DVec3,
    pub normal: DVec3,
    /// Extent along u and v, metres; for a wall the height of its eaves.
    pub size: DVec2,
    pub seed: u32,
}

/// All triangles of the town but the ground, which is the plane z = 0 inside `ground_half`.
#[derive(Default)]
pub(super) struct Solids {
    pub vertices: Vec<DVec3>,
    pub faces: Vec<[u32; 3]>,
    pub face_surfaces: Vec<u32>,
    /// The first one is the ground.
    pub surfaces: Vec<Surface>,
    pub ground_half: DVec2,
}

/// What the polygons of one solid have in common.
#[derive(Clone, Copy)]
struct Paint {
    building: u32,
    seed: u32,
}

impl Solids {
    pub(super) fn new(layout: &Layout) -> Self {
        let mut solids = Self { ground_half: layout.half + COUNTRYSIDE, ..Self::default() };
        solids.surfaces.push(Surface {
            material: Material::Ground,
            building: 0,
            origin: DVec3::ZERO,
            u: DVec3::X,
            v: DVec3::Y,
            normal: DVec3::Z,
            size: layout.half,
            seed: 77,
        });
        for house in &layout.houses {
            solids.add_house(house);
        }
        for tree in &layout.trees {
            solids.add_tree(tree);
        }
        for car in &layout.cars {
            solids.add_car(car);
        }
        solids
    }

    pub(super) fn corners(&self, face: usize) -> [DVec3; 3] {
        self.faces[face].map(|v| self.vertices[v as usize])
    }

    pub(super) fn surface_of(&self, face: u32) -> &Surface {
        &self.surfaces[self.face_surfaces[face as usize] as usize]
    }

    fn push_vertices(&mut self, points: impl IntoIterator<Item = DVec3>) -> u32 {
        let first = self.vertices.len() as u32;
        self.vertices.extend(points);
        first
    }

    /// A convex polygon, counter-clockwise from outside; its texture starts at the first corner and runs along the
    /// first edge.
    fn push_polygon(&mut self, corners: &[u32], material: Material, paint: Paint, height: Option<f64>) {
        let at = |k: usize| self.vertices[corners[k] as usize];
        let u = (at(1) - at(0)).normalize();
        let normal = u.cross(at(corners.len() - 1) - at(0)).normalize();
        let v = normal.cross(u);
        let mut origin = at(0);
        if material == Material::Wall {
            origin.z = 0.0;
        }
        let reach = |axis: DVec3| (0..corners.len()).map(|k| (at(k) - origin).dot(axis)).fold(0.0, f64::max);
        let size = DVec2::new(reach(u), height.unwrap_or_else(|| reach(v)));
        // A car is of one colour; every other surface has its own pattern.
        let surface_seed = hash(paint.seed as i32, self.surfaces.len() as i32, 11);
        let seed = if material == Material::Car { paint.seed } else { surface_seed };
        let surface = self.surfaces.len() as u32;
        self.surfaces.push(Surface { material, building: paint.building, origin, u, v, normal, size, seed });
        for k in 1..corners.len() - 1 {
            self.faces.push([corners[0], corners[k], corners[k + 1]]);
            self.face_surfaces.push(surface);
        }
    }

    fn add_house(&mut self, house: &House) {
        let paint = Paint { building: house.number, seed: house.seed };
        let corners = house.corners();
        let base = self.push_vertices(corners.map(|c| c.extend(-CELLAR)));
        let top = self.push_vertices(corners.map(|c| c.extend(house.eaves)));
        self.push_polygon(&[base + 3, base + 2, base + 1, base], Material::Masonry, paint, None);
        if house.rise == 0.0 {
            for k in 0..4 {
                let n = (k + 1) % 4;
                self.push_polygon(&[base + k, base + n, top + n, top + k], Material::Wall, paint, Some(house.eaves));
            }
            self.push_polygon(&[top, top + 1, top + 2, top + 3], Material::Gravel, paint, None);
            self.add_roof_boxes(house, paint);
            return;
        }
        // Side `s` and the one opposite carry the eaves; the ridge runs along them.
        let s = u32::from(!house.ridge_along_x);
        let ridge = house.eaves + house.rise;
        let half_way = |a: u32, b: u32| ((corners[a as usize] + corners[b as usize]) / 2.0).extend(ridge);
        let side = |k: u32| (s + k) % 4;
        let ends = self.push_vertices([half_way(side(3), side(0)), half_way(side(1), side(2))]);
        for k in [0, 2] {
            let (a, b) = (side(k), side(k + 1));
            self.push_polygon(&[base + a, base + b, top + b, top + a], Material::Wall, paint, Some(house.eaves));
            let (near, far) = if k == 0 { (ends, ends + 1) } else { (ends + 1, ends) };
            self.push_polygon(&[top + a, top + b, far, near], Material::Tiles, paint, None);
            let c = side(k + 2);
            self.push_polygon(&[base + b, base + c, top + c, far, top + b], Material::Wall, paint, Some(house.eaves));
        }
        self.add_chimney(house, paint);
    }

    fn add_chimney(&mut self, house: &House, paint: Paint) {
        let pick = |salt: i32| f64::from(hash(house.seed as i32, salt, 5) & 0xFF) / 255.0;
        let along = (pick(1) * 2.0 - 1.0) * 0.5;
        let across = if pick(2) < 0.5 { -0.22 } else { 0.22 };
        let own = if house.ridge_along_x { DVec2::new(along, across) } else { DVec2::new(across, along) };
        let ridge = house.eaves + house.rise;
        let half = DVec2::new(0.35 + 0.15 * pick(3), 0.4);
        self.add_box(house, own * house.half, half, [ridge - 1.5, ridge + 0.7], Material::Masonry, paint);
    }

    /// A stair house and two ventilators.
    fn add_roof_boxes(&mut self, house: &House, paint: Paint) {
        let sign = |salt: i32| if hash(house.seed as i32, salt, 5) & 1 == 0 { 1.0 } else { -1.0 };
        let (sx, sy, z) = (sign(1), sign(2), house.eaves);
        let boxes = [
            (DVec2::new(0.45 * sx, 0.4 * sy), DVec2::new(1.3, 1.1), 1.9),
            (DVec2::new(-0.5 * sx, 0.5 * sy), DVec2::new(0.5, 0.5), 0.7),
            (DVec2::new(-0.4 * sx, -0.5 * sy), DVec2::new(0.6, 0.4), 0.9),
        ];
        for (at, half, height) in boxes {
            self.add_box(house, at * house.half, half, [z - 0.2, z + height], Material::Masonry, paint);
        }
    }

    fn add_box(&mut self, house: &House, own: DVec2, half: DVec2, heights: [f64; 2], material: Material, paint: Paint) {
        let plan = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(x, y)| house.plan(own + half * DVec2::new(x, y)));
        self.add_prism(plan, heights, material, paint);
    }

    fn add_prism(&mut self, plan: [DVec2; 4], heights: [f64; 2], material: Material, paint: Paint) {
        let base = self.push_vertices(plan.map(|c| c.extend(heights[0])));
        let top = self.push_vertices(plan.map(|c| c.extend(heights[1])));
        self.push_polygon(&[base + 3, base + 2, base + 1, base], material, paint, None);
        self.push_polygon(&[top, top + 1, top + 2, top + 3], material, paint, None);
        for k in 0..4 {
            let n = (k + 1) % 4;
            self.push_polygon(&[base + k, base + n, top + n, top + k], material, paint, None);
        }
    }

    fn add_car(&mut self, car: &Car) {
        let paint = Paint { building: 0, seed: car.seed };
        let along = if car.along_x { DVec2::X } else { DVec2::Y };
        let plan = |x: f64, y: f64| {
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(a, b)| car.at + along * (a * x) + along.perp() * (b * y))
        };
        self.add_prism(plan(2.1, 0.87), [0.25, 0.85], Material::Car, paint);
        self.add_prism(plan(1.15, 0.75), [0.8, 1.4], Material::Car, paint);
    }

    fn add_tree(&mut self, tree: &Tree) {
        let paint = Paint { building: 0, seed: tree.seed };
        let radius = DVec3::new(tree.radius, tree.radius, tree.radius * 1.15);
        let center = tree.at.extend(tree.trunk + radius.z * 0.9);
        let quarter = DVec2::new(0.16, 0.16);
        let plan =
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| tree.at + quarter * DVec2::new(x, y));
        self.add_prism(plan, [-CELLAR, center.z], Material::Trunk, paint);
        let surface = self.surfaces.len() as u32;
        self.surfaces.push(Surface {
            material: Material::Crown,
            building: 0,
            origin: center,
            u: DVec3::X,
            v: DVec3::Y,
            normal: DVec3::Z,
            size: DVec2::splat(tree.radius),
            seed: tree.seed,
        });
        let (directions, faces) = sphere();
        let first = self.push_vertices(directions.iter().enumerate().map(|(k, &direction)| {
            let bump = f64::from(hash(tree.seed as i32, k as i32, 3) & 0xFFFF) / 65535.0;
            center + direction * radius * (0.82 + 0.26 * bump)
        }));
        for face in faces {
            self.faces.push(face.map(|v| v + first));
            self.face_surfaces.push(surface);
        }
    }
}

/// An octahedron subdivided three times: unit vectors and faces, counter-clockwise from outside.
fn sphere() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut points = vec![DVec3::X, DVec3::Y, DVec3::NEG_X, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    let mut faces: Vec<[u32; 3]> = (0..4u32).flat_map(|k| [[k, (k + 1) % 4, 4], [(k + 1) % 4, k, 5]]).collect();
    for _ in 0..3 {
        let mut halves = std::collections::BTreeMap::new();
        let mut next = Vec::with_capacity(faces.len() * 4);
        for [a, b, c] in faces {
            let mut half = |i: u32, j: u32| {
                *halves.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    points.push((points[i as usize] + points[j as usize]).normalize());
                    points.len() as u32 - 1
                })
            };
            let (ab, bc, ca) = (half(a, b), half(b, c), half(c, a));
            next.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        faces = next;
    }
    (points, faces)
}
