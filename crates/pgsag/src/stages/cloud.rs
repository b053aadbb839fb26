//! Gaussians in the layout that all splat viewers open: raw parameters as floats about the group's origin.

use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use pgsag_scene::files::ply::{FloatTable, origin_world, read_floats, write_floats};
use pgsag_splat::SplatCloud;

use super::read;

fn names(basis_count: usize) -> Vec<String> {
    let words = |list: &[&str]| list.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    let mut names = words(&["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]);
    names.extend((0..3 * (basis_count - 1)).map(|k| format!("f_rest_{k}")));
    names.extend(words(&["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]));
    names
}

/// Writes a cloud.
///
/// # Errors
/// Where the file cannot be written.
pub fn write_cloud(path: &Path, cloud: &SplatCloud) -> Result<()> {
    let basis_count = cloud.basis_count();
    let names = names(basis_count);
    let mut values = Vec::with_capacity(names.len() * cloud.len());
    for i in 0..cloud.len() {
        let harmonics = &cloud.harmonics[3 * basis_count * i..3 * basis_count * (i + 1)];
        values.extend(cloud.means[i]);
        values.extend([0.0; 3]);
        values.extend(&harmonics[..3]);
        // The layout wants channel by channel, ours is basis function by basis function.
        values.extend((0..3).flat_map(|channel| harmonics[3 + channel..].iter().step_by(3).copied()));
        values.push(cloud.opacity_logits[i]);
        values.extend(cloud.log_scales[i]);
        values.extend(cloud.rotations[i]);
    }
    let [x, y, z] = cloud.origin_world;
    let table = FloatTable { names, values, comments: vec![format!("origin_world {x:?} {y:?} {z:?}")] };
    let file = std::fs::File::create(path).with_context(|| format!("{}", path.display()))?;
    let mut out = std::io::BufWriter::new(file);
    write_floats(&mut out, &table).with_context(|| format!("{}", path.display()))?;
    std::io::Write::flush(&mut out).with_context(|| format!("{}", path.display()))
}

/// Reads what [`write_cloud`] wrote.
///
/// # Errors
/// Where the file is damaged.
pub fn read_cloud(path: &Path) -> Result<SplatCloud> {
    let (file, bytes) = read(path)?;
    let table = read_floats(&file, &bytes)?;
    let width = table.names.len();
    let basis_count = width.saturating_sub(14) / 3;
    ensure!(width >= 17 && table.names == names(basis_count), "{file}: is not laid out as a cloud of Gaussians");
    let sh_degree = (0..=3).find(|degree: &u8| (usize::from(*degree) + 1).pow(2) == basis_count);
    let mut cloud = SplatCloud {
        origin_world: origin_world(&table.comments).with_context(|| format!("{file}: no origin_world"))?,
        sh_degree: sh_degree.with_context(|| format!("{file}: {basis_count} basis functions"))?,
        ..SplatCloud::default()
    };
    let rest = basis_count - 1;
    for row in table.values.chunks_exact(width) {
        let three = |at: usize| [row[at], row[at + 1], row[at + 2]];
        cloud.means.push(three(0));
        cloud.harmonics.extend(three(6));
        cloud.harmonics.extend((0..rest).flat_map(|k| (0..3).map(move |channel| row[9 + channel * rest + k])));
        let at = 9 + 3 * rest;
        cloud.opacity_logits.push(row[at]);
        cloud.log_scales.push(three(at + 1));
        cloud.rotations.push([row[at + 4], row[at + 5], row[at + 6], row[at + 7]]);
    }
    Ok(cloud)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cloud_survives_its_file_bit_for_bit() {
        let cloud = SplatCloud {
            origin_world: [500_000.123_456_789, -0.1, 3.0],
            sh_degree: 1,
            means: vec![[1.0, 2.0, 3.0], [0.1, -0.2, 1e-7]],
            log_scales: vec![[-1.0, -2.0, -3.0], [0.5, 0.25, 0.125]],
            rotations: vec![[1.0, 0.0, 0.0, 0.0], [0.1, 0.2, 0.3, 0.4]],
            opacity_logits: vec![0.5, -4.0],
            harmonics: (0..24).map(|k| k as f32 * 0.1).collect(),
        };
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("cloud.ply");
        write_cloud(&path, &cloud).expect("written");
        assert_eq!(read_cloud(&path).expect("read"), cloud);
    }
}
