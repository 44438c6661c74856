//! What the rivals of the hawks have in common: members with a place and a value each, the best
//! place of all, and the order in which members move and are evaluated.
//!
//! Why: so that the file of a method holds its settings and its rules, and nothing else. The hawks
//! are not here, because what they evaluate next depends on what they were told last.

use super::Bounds;
use super::search::{Contest, Swarm, Wish};

/// The members and what is known of them.
#[derive(Debug, Clone)]
pub(super) struct Crowd {
    pub(super) places: Vec<Vec<f64>>,
    /// The values there; infinite where none is known.
    pub(super) fitness: Vec<f64>,
    pub(super) best: Vec<f64>,
    pub(super) best_fitness: f64,
}

impl Crowd {
    fn new(places: Vec<Vec<f64>>) -> Self {
        Self {
            fitness: vec![f64::INFINITY; places.len()],
            best: places[0].clone(),
            best_fitness: f64::INFINITY,
            places,
        }
    }

    /// Takes the values of the members where they are; those of the last ones may be missing.
    fn take_all(&mut self, values: &[f64]) {
        self.fitness.fill(f64::INFINITY);
        for (i, &value) in values.iter().enumerate() {
            self.fitness[i] = value;
            if value < self.best_fitness {
                self.best.clone_from(&self.places[i]);
                self.best_fitness = value;
            }
        }
    }

    /// Takes the value at a trial point of member `i`, which goes there if it is no worse.
    fn take_trial(&mut self, i: usize, point: Vec<f64>, value: f64) {
        if value <= self.best_fitness {
            self.best.clone_from(&point);
            self.best_fitness = value;
        }
        if value <= self.fitness[i] {
            (self.places[i], self.fitness[i]) = (point, value);
        }
    }
}

/// The rules of a method whose members all move before they are evaluated, better or not.
pub(super) trait MovesAtOnce: Clone + Send + Sync + 'static {
    /// Moves all members after iteration `iteration`, counted from 0; what leaves the box is clipped
    /// afterwards.
    fn move_all(&mut self, crowd: &mut Crowd, iteration: usize);

    /// Hears that the values of `crowd` are new.
    fn learn(&mut self, _crowd: &Crowd) {}
}

/// The rules of a method whose members move one after another, each only to where it is no worse.
pub(super) trait MovesInTurn: Clone + Send + Sync + 'static {
    /// Prepares for a round, in which each member moves once.
    fn begin_round(&mut self, _crowd: &Crowd) {}

    /// Where member `i` might go; what is outside of the box is clipped afterwards.
    fn trial(&mut self, crowd: &Crowd, i: usize) -> Vec<f64>;

    /// Hears the value that member `i` found, whether it goes there or not.
    fn learn(&mut self, _i: usize, _value: f64) {}

    /// Hears that each member has moved.
    fn end_round(&mut self) {}
}

/// A search of members that move at once.
#[derive(Clone)]
pub(super) struct AtOnce<R> {
    crowd: Crowd,
    bounds: Bounds,
    rules: R,
    n_iterations_done: usize,
    /// Whether the values of all members are known, so that the iteration is over.
    is_evaluated: bool,
}

impl<R: MovesAtOnce> AtOnce<R> {
    pub(super) fn new(places: Vec<Vec<f64>>, bounds: &Bounds, rules: R) -> Self {
        Self {
            crowd: Crowd::new(places),
            bounds: bounds.clone(),
            rules,
            n_iterations_done: 0,
            is_evaluated: false,
        }
    }
}

impl<R: MovesAtOnce> Herd for AtOnce<R> {
    fn crowd(&self) -> &Crowd {
        &self.crowd
    }

    fn wish(&mut self) -> Wish {
        if self.is_evaluated {
            self.is_evaluated = false;
            self.n_iterations_done += 1;
            return Wish::EndOfIteration;
        }
        if self.n_iterations_done > 0 {
            let iteration = self.n_iterations_done - 1;
            self.rules.move_all(&mut self.crowd, iteration);
            for place in &mut self.crowd.places {
                self.bounds.clip(place);
            }
        }
        Wish::values(self.crowd.places.clone())
    }

    fn tell(&mut self, _: Vec<Vec<f64>>, values: &[f64]) {
        self.is_evaluated = true;
        self.crowd.take_all(values);
        self.rules.learn(&self.crowd);
    }
}

/// A search of members that move in turn.
#[derive(Clone)]
pub(super) struct InTurn<R> {
    crowd: Crowd,
    bounds: Bounds,
    rules: R,
    next: Next,
}

/// What is to be done next.
#[derive(Clone, Copy)]
enum Next {
    /// Evaluate all members where they start.
    Start,
    /// Evaluate the trial point of this member.
    Member(usize),
    /// End the iteration.
    End,
}

impl<R: MovesInTurn> InTurn<R> {
    pub(super) fn new(places: Vec<Vec<f64>>, bounds: &Bounds, rules: R) -> Self {
        Self {
            crowd: Crowd::new(places),
            bounds: bounds.clone(),
            rules,
            next: Next::Start,
        }
    }
}

impl<R: MovesInTurn> Herd for InTurn<R> {
    fn crowd(&self) -> &Crowd {
        &self.crowd
    }

    fn wish(&mut self) -> Wish {
        match self.next {
            Next::Start => Wish::values(self.crowd.places.clone()),
            Next::Member(i) => {
                let mut point = self.rules.trial(&self.crowd, i);
                self.bounds.clip(&mut point);
                Wish::Values {
                    points: vec![point],
                    limit: f64::INFINITY,
                    contest: Some(Contest {
                        rival: self.crowd.fitness[i].next_up(), // an equal value is taken, too
                        kind: 0,
                    }),
                }
            }
            Next::End => {
                self.rules.begin_round(&self.crowd);
                self.next = Next::Member(0);
                Wish::EndOfIteration
            }
        }
    }

    fn tell(&mut self, points: Vec<Vec<f64>>, values: &[f64]) {
        self.next = match (self.next, points.into_iter().next(), values.first()) {
            (Next::Member(i), Some(point), Some(&value)) => {
                self.rules.learn(i, value);
                self.crowd.take_trial(i, point, value);
                if i + 1 < self.crowd.places.len() {
                    Next::Member(i + 1)
                } else {
                    self.rules.end_round();
                    Next::End
                }
            }
            (Next::Start, ..) => {
                self.crowd.take_all(values);
                for (i, &value) in values.iter().enumerate() {
                    self.rules.learn(i, value);
                }
                Next::End
            }
            // The calls of the objective are used up.
            _ => Next::End,
        };
    }
}

/// A search by a crowd, in whatever order its members move.
trait Herd: Clone + Send + Sync + 'static {
    fn crowd(&self) -> &Crowd;
    fn wish(&mut self) -> Wish;
    fn tell(&mut self, points: Vec<Vec<f64>>, values: &[f64]);
}

impl<H: Herd> Swarm for H {
    fn wish(&mut self) -> Wish {
        Herd::wish(self)
    }

    fn tell(&mut self, points: Vec<Vec<f64>>, values: &[f64]) {
        Herd::tell(self, points, values);
    }

    fn best(&self) -> (&[f64], f64) {
        let crowd = self.crowd();
        (&crowd.best, crowd.best_fitness)
    }

    fn population(&self) -> (Vec<Vec<f64>>, Vec<f64>) {
        let crowd = self.crowd();
        (crowd.places.clone(), crowd.fitness.clone())
    }

    fn fork(&self) -> Box<dyn Swarm> {
        Box::new(self.clone())
    }
}
