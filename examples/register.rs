//! Registers two clouds of one place, of which nobody knows how they lie to each other.
//!
//! `cargo run --release --example register`

#![allow(clippy::print_stdout)] // the crate never prints, its examples do

use tmchho::random::Stream;
use tmchho::{Config, Point, Rigid, progress::Progress, register};

/// Hills and a wall, as a sensor may see them: `n` points of its own, 2 cm off.
fn survey(n: usize, sensor: u64) -> Vec<Point> {
    let mut noise = Stream::new(1, "survey", sensor);
    let mut point = |i: usize| {
        let (x, y) = (80.0 * noise.uniform(), 60.0 * noise.uniform());
        let hill = 5.0 * (0.11 * x).sin() * (0.13 * y).cos() + 2.0 * (0.003 * x * y).sin();
        match i % 5 {
            0 => [x, 25.0 + 0.3 * x, 8.0 * noise.uniform()],
            _ => [x, y, hill + 0.02 * noise.normal()],
        }
    };
    (0..n).map(&mut point).collect()
}

pub(crate) fn main() -> tmchho::Result<()> {
    // The second sensor has a frame of its own: turned, and far away.
    let truth = Rigid::from_euler([0.4, -2.0, 1.1], [500.0, -80.0, 30.0]);
    let target = survey(12_000, 0);
    let seen = survey(9_000, 1);
    let source: Vec<Point> = seen.iter().map(|p| truth.inverse().apply(p)).collect();

    let found = register(&source, &target, &Config::default(), &Progress::silent())?;

    println!("{}: {}", found.verdict.name(), found.reasons.join("; "));
    for row in found.target_from_source.to_matrix4() {
        println!(
            "{:12.6} {:12.6} {:12.6} {:12.6}",
            row[0], row[1], row[2], row[3]
        );
    }
    println!(
        "overlap of the source: {:.0} %",
        100.0 * found.overlap_of_source
    );
    println!("cloud to cloud: {:.3} m rms", found.source_to_target.rms_m);
    let error = found.target_from_source.rigid * truth.inverse();
    println!(
        "off the truth: {:.6}°",
        error.rotation_angle_rad().to_degrees()
    );
    Ok(())
}
