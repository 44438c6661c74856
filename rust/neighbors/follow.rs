//! The nearest points of places that move a little at a time.
//!
//! Why: ICP asks for the same partners at dozens of poses, most of which differ by less than points lie
//! apart. The nearest point is still the nearest while its place has moved by less than what all
//! others were farther away: then one distance is measured where the tree would be searched.
//! Memory: 72 bytes a place.
//! Source: Greenspan & Godin (2001), whose test by a sphere round the place is this one.
//! Deviates: the second nearest point is measured, not bounded; answers stay exact.

use super::NeighborIndex;
use super::blocks::WIDTH;
use super::collect::NearestTwo;
use crate::cloud::{Point, distance_sq};
use crate::error::Result;
use crate::parallel;
use crate::progress::Progress;

/// A place on its way, and the point nearest to it.
#[derive(Debug, Clone)]
pub(crate) struct Follower {
    /// `u32::MAX` for nobody near.
    index: u32,
    /// Where that point stands.
    nearest: Point,
    distance_sq: f64,
    /// Where the place was when the tree was last asked.
    asked_at: Point,
    /// From there to any point but the nearest it is at least so far.
    others_m: f64,
}

impl Follower {
    /// Of a place that nobody has asked about.
    pub(crate) const NEW: Self = Self {
        index: u32::MAX,
        nearest: [f64::NAN; 3],
        distance_sq: f64::INFINITY,
        asked_at: [f64::NAN; 3],
        others_m: 0.0,
    };

    /// Index and squared distance of the nearest point, if one is known.
    #[inline]
    pub(crate) fn found(&self) -> Option<(u32, f64)> {
        (self.index != u32::MAX).then_some((self.index, self.distance_sq))
    }

    /// Where the nearest point stands; not a number where nobody is near.
    #[inline]
    pub(crate) fn nearest(&self) -> &Point {
        &self.nearest
    }

    /// What is known at `place` of the nearest point within `reach_m`; measures it where that is all.
    #[inline]
    fn move_to(&mut self, place: &Point, reach_m: f64) -> Known {
        /// More than all rounding.
        const SURELY: f64 = 1.0 - 1e-12;
        /// Steps of more than this share of the distance to the nearest point lead to another one.
        const LONG: f64 = 0.5;
        let moved_m = distance_sq(place, &self.asked_at).sqrt();
        let others_m = self.others_m * SURELY - moved_m;
        if self.index == u32::MAX {
            return if others_m > reach_m {
                Known::All
            } else {
                Known::Nothing
            };
        }
        let to_nearest_sq = distance_sq(place, &self.nearest);
        let to_nearest_m = to_nearest_sq.sqrt();
        if to_nearest_m < others_m {
            self.distance_sq = to_nearest_sq;
            Known::All
        } else if moved_m > LONG * to_nearest_m {
            Known::Within(to_nearest_sq)
        } else {
            Known::Nothing
        }
    }
}

/// What is known of the nearest point before asking.
enum Known {
    All,
    /// It is at most so far, squared, and will be another one at the next step: no more is asked than
    /// who it is.
    Within(f64),
    /// Who it is, is worth asking together with for how long.
    Nothing,
}

impl NeighborIndex {
    /// Moves every follower to where `place` says, and finds out who is nearest there: exactly up to
    /// `reach_m`, beyond which it may be somebody or nobody. Followers that come after each other should
    /// stand close together.
    pub(crate) fn follow(
        &self,
        followers: &mut [Follower],
        place: impl Fn(usize) -> Point + Sync + Send,
        reach_m: f64,
        progress: &Progress<'_>,
    ) -> Result<()> {
        /// Looking a little farther than asked tells how long nobody will be near.
        const FARTHER: f64 = 1.5;
        let asked_sq = (FARTHER * reach_m) * (FARTHER * reach_m);
        parallel::for_each_chunk(followers, parallel::CHUNK, |chunk, followers| {
            if progress.check().is_err() {
                return;
            }
            for (group, followers) in followers.chunks_mut(WIDTH).enumerate() {
                let first = chunk * parallel::CHUNK + group * WIDTH;
                let mut places = [[f64::NAN; 3]; WIDTH];
                let mut collectors = [NearestTwo::within(asked_sq); WIDTH];
                let mut n_asked = 0;
                for (lane, follower) in followers.iter_mut().enumerate() {
                    let place = place(first + lane);
                    match follower.move_to(&place, reach_m) {
                        Known::All => continue,
                        Known::Within(sq) => collectors[lane] = NearestTwo::alone_within(sq),
                        Known::Nothing => {}
                    }
                    places[lane] = place;
                    n_asked += 1;
                }
                if n_asked == 0 {
                    continue;
                }
                self.tree.ask_group(&places, &mut collectors);
                for ((follower, place), asked) in followers.iter_mut().zip(places).zip(&collectors)
                {
                    if place[0].is_nan() {
                        continue;
                    }
                    let (found, others_sq) = asked.found();
                    *follower = Follower {
                        index: found.map_or(u32::MAX, |held| held.index),
                        nearest: found.map_or([f64::NAN; 3], |held| self.tree.point(held.slot)),
                        distance_sq: found.map_or(f64::INFINITY, |held| held.distance_sq),
                        asked_at: place,
                        others_m: others_sq.sqrt(),
                    };
                }
            }
        });
        progress.check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;
    use crate::rigid::Rigid;

    #[test]
    fn followers_know_what_a_search_finds_wherever_they_go() {
        let mut stream = Stream::new(1, "follow", 0);
        let mut draw = |n, width: f64| -> Vec<Point> {
            (0..n)
                .map(|_| [0; 3].map(|_| width * stream.uniform()))
                .collect()
        };
        let mut target = draw(3000, 1.0);
        target.extend_from_within(..500); // coincident points
        let (index, source) = (NeighborIndex::new(&target), draw(2500, 1.2));
        for reach_m in [0.05, f64::INFINITY] {
            let mut followers = vec![Follower::NEW; source.len()];
            let mut n_known = 0;
            // Steps from large to tiny, one of them none at all.
            for step in [1.0, 0.1, 0.01, 0.001, 0.0, 1e-4, 0.3] {
                let pose = Rigid::from_euler([step, 0.0, -step], [0.1 * step, 0.0, step]);
                let before = followers.clone();
                let place = |i: usize| pose.apply(&source[i]);
                index
                    .follow(&mut followers, place, reach_m, &Progress::silent())
                    .unwrap();
                for (i, follower) in followers.iter().enumerate() {
                    let wanted = index.nearest_within(&place(i), reach_m * reach_m);
                    let found = follower.found().filter(|(_, sq)| *sq <= reach_m * reach_m);
                    assert_eq!(found, wanted.map(|n| (n.index, n.distance_sq)));
                    n_known += usize::from(before[i].asked_at == follower.asked_at);
                }
            }
            assert!(n_known > source.len(), "{n_known}");
        }
    }
}
