//! What differs from run to run, and is the same with the same seed: errors of the arms' joints, places of bodies.

use ambf_plugin::View;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// SplitMix64 (Steele, Lea and Flood 2014): a few lines in any language, so that clients can draw the same numbers.
#[derive(Debug, Clone)]
pub struct Random(u64);

impl Random {
    /// Numbers of a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform from 0 up to, not including, 1.
    pub fn share(&mut self) -> f64 {
        // The upper 53 bits are exact as a fraction.
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Errors of an arm's joints: uniform between the bounds and their opposites, rad or m.
pub fn errors(random: &mut Random, bounds: &[f64]) -> Vec<f64> {
    bounds.iter().map(|bound| bound * (2.0 * random.share() - 1.0)).collect()
}

/// Bodies that stand at different places in each run, each place taken once.
#[derive(Debug, Clone, PartialEq)]
pub struct ScatterConfig {
    /// Names of bodies.
    pub bodies: Vec<String>,
    /// x and y of the places, world, m; at least one a body.
    pub places: Vec<[f64; 2]>,
}

/// The same in a scene.
#[derive(Debug, Clone)]
pub struct Scatter {
    /// Bodies, and their poses at the start: z and orientation stay, but for a turn about the world's z.
    bodies: Vec<(usize, Isometry3<f64>)>,
    places: Vec<[f64; 2]>,
}

impl Scatter {
    /// `None` when a body has no pose.
    pub fn new(world: &View<'_>, bodies: &[usize], places: &[[f64; 2]]) -> Option<Self> {
        let starts = bodies.iter().map(|&body| Some((body, world.body(body)?.pose)));
        Some(Self { bodies: starts.collect::<Option<Vec<_>>>()?, places: places.to_vec() })
    }

    /// Where the bodies stand with a seed.
    pub fn poses(&self, seed: u64) -> Vec<(usize, Isometry3<f64>)> {
        // Not the numbers of the joints' errors.
        let mut random = Random::new(!seed);
        let mut free = self.places.clone();
        let mut place = |&(body, start): &(usize, Isometry3<f64>)| {
            let at = (random.share() * free.len() as f64) as usize;
            let [x, y] = free.remove(at);
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::TAU * random.share());
            let pose = Isometry3::from_parts(Translation3::new(x, y, start.translation.z), turn * start.rotation);
            (body, pose)
        };
        self.bodies.iter().map(&mut place).collect()
    }

    /// Puts the bodies where they stand with a seed, at rest.
    pub fn apply(&self, world: &mut View<'_>, seed: u64) {
        for (body, pose) in self.poses(seed) {
            // A body that has left the scene needs no place.
            let _ = world.set_pose(body, pose);
            let _ = world.set_velocity(body, Vector3::zeros(), Vector3::zeros());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_splitmix() {
        // The reference implementation's for the seed 1234567, which Python's side is compared with, too.
        let mut random = Random::new(1_234_567);
        let expected: [u64; 3] = [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423];
        assert_eq!([random.next(), random.next(), random.next()], expected);
        let mut random = Random::new(7);
        let drawn: Vec<f64> = (0..1000).flat_map(|_| errors(&mut random, &[0.1, 0.005])).collect();
        assert!(drawn.chunks(2).all(|pair| pair[0].abs() <= 0.1 && pair[1].abs() <= 0.005));
        let mean = drawn.chunks(2).map(|pair| pair[0]).sum::<f64>() / 1000.0;
        // A standard deviation is 0.1/√3/√1000.
        assert!(mean.abs() < 0.008, "{mean}");
    }

    #[test]
    fn each_place_is_taken_once_and_a_seed_gives_the_same_places() {
        let start = Isometry3::translation(9.0, 9.0, 0.729);
        let places = vec![[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]];
        let scatter = Scatter { bodies: vec![(4, start), (7, start)], places: places.clone() };
        let mut seen = Vec::new();
        for seed in 0..200 {
            let poses = scatter.poses(seed);
            assert_eq!(poses, scatter.poses(seed));
            let at: Vec<usize> = poses
                .iter()
                .map(|(_, pose)| {
                    let t = pose.translation.vector;
                    assert!((t.z - 0.729).abs() < 1e-12);
                    places.iter().position(|&[x, y]| (t.x - x).abs() + (t.y - y).abs() < 1e-12).unwrap()
                })
                .collect();
            assert_ne!(at[0], at[1]);
            seen.push(at);
        }
        seen.sort();
        seen.dedup();
        assert_eq!(seen.len(), 6, "all arrangements occur");
    }
}
