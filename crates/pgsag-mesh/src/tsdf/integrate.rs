//! The running mean of the distances, block by block. Blocks are independent, so threads change nothing.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::planes::PixelPlane;
use super::{BLOCK_SIDE, Block, Lattice, TsdfOptions, Volume};
use crate::fuse::DepthView;

/// A view in the numbers of the inner loop.
struct Projector<'a> {
    view: &'a DepthView<'a>,
    planes: &'a [PixelPlane],
    lattice: Lattice,
    options: TsdfOptions,
    /// Steps of one node along the lattice axes, camera frame.
    steps: [Vec3; 3],
    focal: [f32; 2],
    center: [f32; 2],
}

impl Volume {
    /// Averages a view into the blocks it sees from the `first` on, or into `touched` alone where there is no carving.
    pub(super) fn average(&mut self, view: &DepthView<'_>, planes: &[PixelPlane], touched: &[[i32; 3]], first: usize) {
        let rotation = view.camera_from_world.rotation_matrix();
        let camera = view.camera;
        let projector = Projector {
            view,
            planes,
            lattice: self.lattice,
            options: self.options,
            steps: [rotation.x_axis, rotation.y_axis, rotation.z_axis]
                .map(|axis| (axis * self.lattice.voxel).as_vec3()),
            focal: [camera.fx as f32, camera.fy as f32],
            center: [camera.cx as f32, camera.cy as f32],
        };
        let mut wanted = vec![self.options.free_space_weight > 0.0; self.blocks.len()];
        for key in touched {
            wanted[self.index[key] as usize] = true;
        }
        self.blocks
            .par_iter_mut()
            .zip(&self.keys)
            .zip(&wanted)
            .skip(first)
            .filter(|(_, wanted)| **wanted)
            .for_each(|((block, key), _)| projector.average_block(block, *key));
    }
}

impl Projector<'_> {
    fn average_block(&self, block: &mut Block, key: [i32; 3]) {
        let base = self.lattice.node(key.map(|k| k * BLOCK_SIDE));
        let base = self.view.camera_from_world.transform_point(base);
        if !self.in_sight(base) {
            return;
        }
        let base = base.as_vec3();
        for k in 0..BLOCK_SIDE {
            for j in 0..BLOCK_SIDE {
                let row = base + self.steps[2] * k as f32 + self.steps[1] * j as f32;
                let first = ((k * BLOCK_SIDE + j) * BLOCK_SIDE) as usize;
                for i in 0..BLOCK_SIDE as usize {
                    self.average_node(block, first + i, row + self.steps[0] * i as f32);
                }
            }
        }
    }

    /// Whether the ball about a block may show in the image.
    fn in_sight(&self, base: DVec3) -> bool {
        let half = f64::from(BLOCK_SIDE - 1) * 0.5;
        let middle = base + (self.steps[0] + self.steps[1] + self.steps[2]).as_dvec3() * half;
        let radius = self.lattice.voxel * half * 1.733;
        let camera = &self.view.camera;
        if middle.z <= radius {
            return middle.z > -radius;
        }
        let Some(at) = camera.project(middle) else { return false };
        // A ball at (x, z) reaches at most radius * (1 + |x / z|) / (z - radius) from its centre on the plane z = 1.
        let reach = |offset: f64, focal: f64| radius * (focal + (offset).abs()) / (middle.z - radius);
        let (dx, dy) = (reach(at.x - camera.cx, camera.fx), reach(at.y - camera.cy, camera.fy));
        at.x >= -dx && at.y >= -dy && at.x <= f64::from(camera.width) + dx && at.y <= f64::from(camera.height) + dy
    }

    /// What a measurement counts at so many voxels in front of its surface, as a share of its weight.
    #[inline]
    fn share(&self, distance: f32) -> f32 {
        let options = &self.options;
        if distance > options.front_voxels {
            options.free_space_weight
        } else {
            1.0 + (1.0 - options.behind_weight) * (distance / options.behind_voxels).clamp(-1.0, 0.0)
        }
    }

    #[inline]
    fn average_node(&self, block: &mut Block, node: usize, at: Vec3) {
        if at.z <= 0.0 {
            return;
        }
        let inverse = 1.0 / at.z;
        let u = self.focal[0] * at.x * inverse + self.center[0];
        let v = self.focal[1] * at.y * inverse + self.center[1];
        let camera = &self.view.camera;
        if !(u >= 0.0 && v >= 0.0 && u < camera.width as f32 && v < camera.height as f32) {
            return;
        }
        let pixel = v as usize * camera.width as usize + u as usize;
        let plane = &self.planes[pixel];
        if plane.weight <= 0.0 {
            return;
        }
        let distance = (plane.normal.dot(at) + plane.offset) / self.lattice.voxel as f32;
        if distance < -self.options.behind_voxels {
            return;
        }
        let free = distance > self.options.front_voxels;
        let weight = plane.weight * self.share(distance);
        if weight <= 0.0 {
            return;
        }
        let total = block.weight[node] + weight;
        let value = (distance / self.options.front_voxels).min(1.0);
        block.distance[node] += (value - block.distance[node]) * (weight / total);
        block.weight[node] = total;
        if let (false, Some(image), Some(colors)) = (free, self.view.color, &mut block.color) {
            blend(&mut colors[node], image.pixels[pixel], weight);
        }
    }
}

/// Running mean of a colour in 8.8 fixed point; the fourth number is the weight so far.
fn blend(mean: &mut [u16; 4], color: [u8; 3], weight: f32) {
    let weight = (weight * 256.0).clamp(1.0, 65535.0);
    let total = (f32::from(mean[3]) + weight).min(65535.0);
    let share = (weight / total).min(1.0);
    for c in 0..3 {
        let old = f32::from(mean[c]);
        mean[c] = (old + (f32::from(color[c]) * 256.0 - old) * share + 0.5) as u16;
    }
    mean[3] = total as u16;
}
