//! Rigid motions, named `a_from_b`: they carry a point in frame b to the same point in frame a.

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// A rotation and a translation: `p_a = rotation * p_b + translation`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RigidTransform {
    /// Unit quaternion (glam order x y z w in memory; files use w x y z).
    pub rotation: DQuat,
    /// In scene units.
    pub translation: DVec3,
}

impl RigidTransform {
    /// The motion that moves nothing.
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// Carries a point from frame b to frame a.
    #[must_use]
    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// `b_from_a`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// Where frame a's origin lies in frame b; for `camera_from_world`, the camera centre in the world.
    #[must_use]
    pub fn origin_of_a(&self) -> DVec3 {
        -(self.rotation.inverse() * self.translation)
    }

    /// The rotation as a matrix.
    #[must_use]
    pub fn rotation_matrix(&self) -> DMat3 {
        DMat3::from_quat(self.rotation)
    }

    /// The same motion for a frame b whose origin is moved to `origin` (given in the old frame b).
    #[must_use]
    pub fn with_origin(&self, origin: DVec3) -> Self {
        Self { rotation: self.rotation, translation: self.transform_point(origin) }
    }
}

impl std::ops::Mul for RigidTransform {
    type Output = Self;

    /// `a_from_b * b_from_c = a_from_c`.
    fn mul(self, b_from_c: Self) -> Self {
        Self {
            rotation: self.rotation * b_from_c.rotation,
            translation: self.rotation * b_from_c.translation + self.translation,
        }
    }
}
