//! `seams CITY.ply VOXEL`: how well buildings and background meet in a finished city (VOXEL in scene units).
#![expect(clippy::print_stdout, reason = "an example speaks on standard output")]

use std::error::Error;

use pgsag_mesh::seams::seams;
use pgsag_scene::files::ply::read_mesh;

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [city, voxel] = words.as_slice() else { return Err("use seams CITY.ply VOXEL".into()) };
    let found = seams(&read_mesh(city, &std::fs::read(city)?)?, voxel.parse()?);
    println!(
        "border {:.1}; open edges within two voxels {:.2} % of it; steps within a voxel {:.2} %",
        found.border,
        100.0 * found.open_share,
        100.0 * found.close_share
    );
    Ok(())
}
