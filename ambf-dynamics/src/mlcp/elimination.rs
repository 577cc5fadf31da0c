//! Order in which bodies are eliminated from a symmetric matrix, and the blocks of its Cholesky factor that are not 0:
//! minimum degree (George and Liu, *SIAM Review* 31, 1989) on a quotient graph.
//!
//! What is attached to one body only, such as the end of a chain, comes first and leaves no trace in the rest of the factor: of a
//! tree the factor has no more blocks than the matrix, and of a loop one more for each body of it.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Degree of a body that was eliminated, or has no rows.
const GONE: u32 = u32::MAX;

/// An elimination order. Memory is kept.
#[derive(Debug, Default)]
pub(super) struct Elimination {
    /// Bodies in their order.
    pub order: Vec<u32>,
    /// Bodies with which the k-th one of the order is connected when it is eliminated: `below[start[k]..start[k + 1]]`.
    pub below: Vec<u32>,
    pub start: Vec<u32>,
    /// Velocity components of the bodies with which each body is connected.
    degree: Vec<u32>,
    /// Place of each eliminated body in the order.
    place: Vec<u32>,
    /// Of each body: eliminated bodies that stand for all in their `below`, then bodies. They begin where its neighbours do.
    links: Vec<u32>,
    /// Where the bodies of each body begin and end in `links`.
    bodies: Vec<(u32, u32)>,
    queue: BinaryHeap<Reverse<(u32, u32)>>,
    /// Number of the last search that met each body, or went through it.
    met: Vec<u32>,
    search: u32,
}

impl Elimination {
    /// Finds the order of all bodies for which `has_rows` is true. The neighbours of body `b`, all of which have rows, are
    /// `neighbours[start[b]..start[b + 1]]`, each of them once or more often; `size` is the number of its velocity components.
    pub fn find(
        &mut self,
        neighbours: &[u32],
        start: &[u32],
        has_rows: impl Fn(usize) -> bool,
        size: impl Fn(usize) -> u32,
    ) {
        let count = start.len() - 1;
        self.order.clear();
        self.below.clear();
        self.start.clear();
        self.start.push(0);
        self.links.clear();
        self.links.extend_from_slice(neighbours);
        self.bodies.clear();
        self.bodies.extend((0..count).map(|body| (start[body], start[body + 1])));
        self.degree.clear();
        self.degree.resize(count, GONE);
        self.place.clear();
        self.place.resize(count, 0);
        self.met.clear();
        self.met.resize(count, 0);
        self.search = 0;
        self.queue.clear();
        for body in (0..count).filter(|&body| has_rows(body)) {
            self.update_degree(body, start, &size);
        }
        while let Some(Reverse((degree, body))) = self.queue.pop() {
            if self.degree[body as usize] == degree {
                self.eliminate(body as usize, start, &size);
            }
        }
    }

    /// Place of a body in the order.
    pub fn place(&self, body: u32) -> u32 {
        self.place[body as usize]
    }

    fn eliminate(&mut self, body: usize, start: &[u32], size: &impl Fn(usize) -> u32) {
        let at = self.below.len();
        self.gather(body, start);
        self.place[body] = self.order.len() as u32;
        self.degree[body] = GONE;
        self.order.push(body as u32);
        self.start.push(self.below.len() as u32);
        let last = self.search;
        for i in at..self.below.len() {
            let other = self.below[i] as usize;
            let (first, end) = (self.bodies[other].0 as usize, self.bodies[other].1 as usize);
            // Eliminated bodies that had this one below them are part of it now.
            let begin = start[other] as usize;
            let mut next = begin;
            for k in begin..first {
                let eliminated = self.links[k];
                if self.met[eliminated as usize] != last {
                    self.links[next] = eliminated;
                    next += 1;
                }
            }
            if next == first {
                // None was: it is a neighbour itself, and leaves its place.
                let at = (first..end).find(|&k| self.links[k] as usize == body).unwrap_or(first);
                self.links.swap(first, at);
            }
            self.links[next] = body as u32;
            next += 1;
            let bodies = next;
            for k in first.max(bodies)..end {
                let neighbour = self.links[k];
                if self.met[neighbour as usize] != last && neighbour as usize != body {
                    self.links[next] = neighbour;
                    next += 1;
                }
            }
            self.bodies[other] = (bodies as u32, next as u32);
        }
        for i in at..self.below.len() {
            self.update_degree(self.below[i] as usize, start, size);
        }
    }

    /// Appends the bodies with which a body is connected to `below`.
    fn gather(&mut self, body: usize, start: &[u32]) {
        self.search += 1;
        self.met[body] = self.search;
        let (first, end) = self.bodies[body];
        for k in first..end {
            self.meet(self.links[k as usize]);
        }
        for k in start[body]..first {
            let eliminated = self.links[k as usize] as usize;
            self.met[eliminated] = self.search;
            let place = self.place[eliminated] as usize;
            for i in self.start[place]..self.start[place + 1] {
                self.meet(self.below[i as usize]);
            }
        }
    }

    fn meet(&mut self, other: u32) {
        let is_left = self.degree[other as usize] != GONE || self.order.is_empty();
        if is_left && std::mem::replace(&mut self.met[other as usize], self.search) != self.search {
            self.below.push(other);
        }
    }

    fn update_degree(&mut self, body: usize, start: &[u32], size: &impl Fn(usize) -> u32) {
        let at = self.below.len();
        self.gather(body, start);
        let degree = self.below[at..].iter().map(|&other| size(other as usize)).sum();
        self.below.truncate(at);
        self.degree[body] = degree;
        self.queue.push(Reverse((degree, body as u32)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eliminates the graph of these edges, and compares each step with elimination by the definition: the neighbours of the
    /// body become neighbours of each other, and no body that is left has fewer. Returns the blocks of the factor.
    fn blocks_of(bodies: usize, edges: &[(usize, usize)]) -> usize {
        let mut start = vec![0; bodies + 1];
        let mut neighbours = Vec::new();
        for body in 0..bodies {
            for &(a, b) in edges {
                neighbours.extend((a == body).then_some(b as u32));
                neighbours.extend((b == body).then_some(a as u32));
            }
            start[body + 1] = neighbours.len() as u32;
        }
        let mut found = Elimination::default();
        found.find(&neighbours, &start, |_| true, |_| 6);

        let mut connected = vec![vec![false; bodies]; bodies];
        for &(a, b) in edges {
            (connected[a][b], connected[b][a]) = (true, true);
        }
        let mut left = vec![true; bodies];
        for (k, &body) in found.order.iter().enumerate() {
            let of =
                |body: usize| (0..bodies).filter(|&other| left[other] && connected[body][other]).collect::<Vec<_>>();
            let expected = of(body as usize);
            let least = (0..bodies).filter(|&body| left[body]).map(|body| of(body).len()).min();
            assert_eq!(Some(expected.len()), least, "body {body}, place {k}");
            let mut below: Vec<_> = found.below[found.start[k] as usize..found.start[k + 1] as usize].to_vec();
            below.sort_unstable();
            assert_eq!(below, expected.iter().map(|&other| other as u32).collect::<Vec<_>>(), "body {body}, place {k}");
            for &a in &expected {
                expected.iter().filter(|&&b| b != a).for_each(|&b| connected[a][b] = true);
            }
            assert!(std::mem::replace(&mut left[body as usize], false), "body {body} is eliminated once");
            assert_eq!(found.place(body), k as u32);
        }
        assert_eq!(found.order.len(), bodies);
        found.below.len()
    }

    #[test]
    fn trees_have_no_blocks_but_their_own_and_loops_one_more_for_each_body_but_three() {
        let tree: Vec<_> = (1..40).map(|body| ((body * 7 % 13) % body, body)).collect();
        assert_eq!(blocks_of(40, &tree), 39);
        let mut of_a_loop: Vec<_> = (1..10).map(|body| (body - 1, body)).collect();
        of_a_loop.push((9, 0));
        assert_eq!(blocks_of(10, &of_a_loop), 10 + 7);
    }

    #[test]
    fn elimination_is_that_of_the_definition() {
        let mut seed = 1_u64;
        let mut random = |below: usize| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 33) as usize % below
        };
        for bodies in 1..30 {
            for _ in 0..20 {
                // Some edges twice, and some bodies without one.
                let edges: Vec<_> = (0..random(3 * bodies)).map(|_| (random(bodies), random(bodies))).collect();
                let edges: Vec<_> = edges.into_iter().filter(|(a, b)| a != b).collect();
                blocks_of(bodies, &edges);
            }
        }
    }
}
