//! The search by hawks against a plain transcription of the published HHO program, without and with
//! the two improvements of the paper.
//!
//! The transcription does everything in the open and leaves nothing out: it evaluates every hawk in
//! every iteration, known or not, one after another, and moves after the last look. The crate does
//! less and must come to the same history, to the bit. Random numbers are drawn in the same order,
//! and trial points are clipped before they are evaluated, as in the crate.

#![allow(clippy::unwrap_used)] // a test that fails may do so at once

use tmchho::optim::{Bounds, HawkOptions, Optimizer, chaos, levy, test_functions};
use tmchho::random::Stream;

const N: usize = 12;
const T: usize = 60;
const D: usize = 5;

/// The best value after each iteration, and the hawks when they were looked at last.
fn published(
    f: fn(&[f64]) -> f64,
    lb: f64,
    ub: f64,
    seed: u64,
    improved: bool,
) -> (Vec<f64>, Vec<Vec<f64>>) {
    let clip = |x: &[f64]| -> Vec<f64> { x.iter().map(|x| x.clamp(lb, ub)).collect() };
    let by_coordinate = |g: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..D).map(g).collect() };

    let mut x = if improved {
        chaos::population(&Bounds::cube(D, lb, ub).unwrap(), N, seed)
    } else {
        let mut start = Stream::new(seed, "uniform start", 0);
        (0..N)
            .map(|_| (0..D).map(|_| lb + (ub - lb) * start.uniform()).collect())
            .collect()
    };
    let mut rand = Stream::new(seed, "hawk moves", 0);
    let mut rand_mutation = Stream::new(seed, "hawk mutation", 0);
    let (mut rabbit, mut rabbit_energy) = (vec![0.0; D], f64::INFINITY);
    let (mut curve, mut last_seen) = (Vec::new(), Vec::new());

    for t in 0..T {
        for hawk in &mut x {
            *hawk = clip(hawk);
            if f(hawk) < rabbit_energy {
                rabbit_energy = f(hawk);
                rabbit.clone_from(hawk);
            }
        }
        curve.push(rabbit_energy);
        last_seen.clone_from(&x);

        for i in 0..N {
            let xi = x[i].clone();
            let mean = by_coordinate(&|d| x.iter().map(|hawk| hawk[d]).sum::<f64>() / N as f64);
            let e0 = -1.0 + 2.0 * rand.uniform();
            let e = 2.0 * e0 * (1.0 - t as f64 / T as f64);
            if e.abs() >= 1.0 {
                if rand.uniform() >= 0.5 {
                    let xr = x[rand.below(N)].clone();
                    let (r1, r2) = (rand.uniform(), rand.uniform());
                    x[i] = by_coordinate(&|d| xr[d] - r1 * (xr[d] - 2.0 * r2 * xi[d]).abs());
                } else {
                    let (r3, r4) = (rand.uniform(), rand.uniform());
                    let place = lb + r4 * (ub - lb);
                    x[i] = by_coordinate(&|d| (rabbit[d] - mean[d]) - r3 * place);
                }
                if improved {
                    x[i] = clip(&x[i]);
                }
                continue;
            }
            if rand.uniform() >= 0.5 {
                if e.abs() < 0.5 {
                    x[i] = by_coordinate(&|d| rabbit[d] - e * (rabbit[d] - xi[d]).abs());
                } else {
                    let j = 2.0 * (1.0 - rand.uniform());
                    x[i] =
                        by_coordinate(&|d| (rabbit[d] - xi[d]) - e * (j * rabbit[d] - xi[d]).abs());
                }
                if improved {
                    x[i] = clip(&x[i]);
                }
            } else {
                let j = 2.0 * (1.0 - rand.uniform());
                let centre = if e.abs() >= 0.5 { &xi } else { &mean };
                let y = by_coordinate(&|d| rabbit[d] - e * (j * rabbit[d] - centre[d]).abs());
                if f(&clip(&y)) < f(&xi) {
                    x[i] = clip(&y);
                } else {
                    let s: Vec<f64> = (0..D).map(|_| rand.uniform()).collect();
                    let z: Vec<f64> = (0..D)
                        .map(|d| {
                            let (u, v) = (rand.normal(), rand.normal());
                            y[d] + s[d] * levy::step(u, v, 1.0)
                        })
                        .collect();
                    if f(&clip(&z)) < f(&xi) {
                        x[i] = clip(&z);
                    }
                }
            }
            if improved && f(&x[i]) >= f(&xi) {
                let mut others: Vec<usize> = (0..N).collect();
                others.remove(i);
                let picked = rand_mutation.sample_indices(N - 1, 3);
                let z = [0, 1, 2].map(|k| x[others[picked[k]]].clone());
                let total: f64 = z.iter().map(|z| f(z).abs()).sum();
                let k = [0, 1, 2].map(|j: usize| match total {
                    0.0 => 1.0 / 3.0,
                    total => f(&z[j]).abs() / total,
                });
                let o = 0.1_f64.sqrt() * rand_mutation.normal();
                let v = clip(&by_coordinate(&|d| {
                    (z[0][d] + z[1][d] + z[2][d]) / 3.0
                        + o * ((k[1] - k[0]) * (z[0][d] - z[1][d])
                            + (k[2] - k[1]) * (z[1][d] - z[2][d])
                            + (k[0] - k[2]) * (z[2][d] - z[0][d]))
                }));
                if f(&v) < f(&x[i]) {
                    x[i] = v;
                }
            }
        }
    }
    (curve, last_seen)
}

#[test]
fn the_search_is_the_published_program_to_the_bit() {
    for (options, improved) in [(HawkOptions::hho(), false), (HawkOptions::tmchho(), true)] {
        let options = HawkOptions {
            n_hawks: N,
            n_iterations: T,
            ..options
        };
        for f in &test_functions::ALL {
            for seed in 0..5 {
                let bounds = Bounds::cube(D, -0.3 * f.range, f.range).unwrap();
                let found = options.minimize(&f.evaluate, &bounds, seed).unwrap();
                let (curve, hawks) = published(f.evaluate, -0.3 * f.range, f.range, seed, improved);
                assert_eq!(found.history, curve, "{} {seed}", f.name);
                assert_eq!(found.population, hawks, "{} {seed}", f.name);
            }
        }
    }
}
