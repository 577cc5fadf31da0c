//! Block LDLᵀ factorisation of \[M Jᵀ; J −E\] in 6 × 6 blocks: a node a body and a node a joint.
//!
//! The matrix is quasi-definite, so that the factors exist for every order of the nodes (Vanderbei, "Symmetric
//! quasidefinite matrices", SIAM J. Optim. 5, 1995). The order is that of minimum degree, but a joint waits for one of
//! its bodies: its pivot is then an effective inverse mass instead of the small block −E.

use std::collections::BTreeSet;

use nalgebra::{Matrix6, Vector6};

/// Most products of blocks in a factorisation, about a second's work; nodes without neighbours in common have none. Many
/// joints between the same two bodies are all coupled with each other.
const MAX_PRODUCTS: usize = 1_000_000;

/// One elimination step, and the blocks that it changes.
struct Pivot {
    node: usize,
    /// Nodes that are eliminated later and coupled to this one, with the number of the block that couples them.
    later: Vec<(usize, usize)>,
    /// For each pair i > j of `later`, by index: number of the block it is added to.
    pairs: Vec<Pair>,
}

struct Pair {
    i: usize,
    j: usize,
    block: usize,
    /// The block is stored as (j, i) instead of (i, j).
    transposed: bool,
}

/// A symmetric block matrix and its factors; the pattern is fixed.
pub(super) struct Factor {
    pivots: Vec<Pivot>,
    /// Diagonal blocks by node; [`factor`](Self::factor) leaves their inverses.
    pub diagonal: Vec<Matrix6<f64>>,
    /// Couplings (row: the node that is eliminated later; column: the earlier one).
    blocks: Vec<Matrix6<f64>>,
    /// Where each coupling given at the start lies: its block, and whether it is transposed there.
    given: Vec<(usize, bool)>,
    /// Nodes below this are bodies (positive definite), the others joints (negative definite).
    n_bodies: usize,
}

impl Factor {
    /// `couplings`: pairs (body, joint), joints counted from `n_bodies`; a pair stands once. `None` where the factors would
    /// have so many blocks that a factorisation takes more than [`MAX_PRODUCTS`] products of them.
    pub fn new(n_bodies: usize, n_joints: usize, couplings: &[(usize, usize)]) -> Option<Self> {
        let n = n_bodies + n_joints;
        let mut neighbours = vec![BTreeSet::new(); n];
        for &(body, joint) in couplings {
            neighbours[body].insert(joint);
            neighbours[joint].insert(body);
        }
        // The nodes that may go, by the number of their neighbours.
        let mut next: BTreeSet<(usize, usize)> = (0..n_bodies).map(|node| (neighbours[node].len(), node)).collect();
        let mut may_go: Vec<bool> = (0..n).map(|node| node < n_bodies).collect();
        let mut products = 0;
        // Numbers of blocks by (later, earlier) node.
        let mut numbers = std::collections::HashMap::new();
        let mut pivots: Vec<Pivot> = Vec::with_capacity(n);
        while let Some((_, node)) = next.pop_first() {
            let around = std::mem::take(&mut neighbours[node]);
            products += around.len() * around.len() / 2;
            if products > MAX_PRODUCTS {
                return None;
            }
            let mut later = Vec::with_capacity(around.len());
            for &other in &around {
                let number = numbers.len();
                numbers.insert((other, node), number);
                later.push((other, number));
                next.remove(&(neighbours[other].len(), other));
                neighbours[other].remove(&node);
                neighbours[other].extend(around.iter().copied().filter(|&third| third != other));
                may_go[other] |= node < n_bodies;
                if may_go[other] {
                    next.insert((neighbours[other].len(), other));
                }
            }
            pivots.push(Pivot { node, later, pairs: Vec::new() });
        }
        for pivot in &mut pivots {
            for i in 0..pivot.later.len() {
                for j in 0..i {
                    let (a, b) = (pivot.later[i].0, pivot.later[j].0);
                    let (block, transposed) = find(&numbers, a, b);
                    pivot.pairs.push(Pair { i, j, block, transposed });
                }
            }
        }
        let given = couplings.iter().map(|&(body, joint)| find(&numbers, joint, body)).collect();
        Some(Self {
            pivots,
            diagonal: vec![Matrix6::zeros(); n],
            blocks: vec![Matrix6::zeros(); numbers.len()],
            given,
            n_bodies,
        })
    }

    /// Sets all couplings to zero.
    pub fn clear(&mut self) {
        self.blocks.fill(Matrix6::zeros());
    }

    /// Sets the coupling with index `coupling` of those given at the start: rows of the joint, columns of the body.
    pub fn couple(&mut self, coupling: usize, jacobian: &Matrix6<f64>) {
        let (block, transposed) = self.given[coupling];
        self.blocks[block] = if transposed { jacobian.transpose() } else { *jacobian };
    }

    /// Factorises; `None` when a pivot is singular or not finite.
    pub fn factor(&mut self) -> Option<()> {
        for pivot in &self.pivots {
            let sign = if pivot.node < self.n_bodies { 1.0 } else { -1.0 };
            let inverse = (self.diagonal[pivot.node] * sign).cholesky()?.inverse() * sign;
            self.diagonal[pivot.node] = inverse;
            for &(other, block) in &pivot.later {
                let coupling = self.blocks[block];
                self.diagonal[other] -= coupling * inverse * coupling.transpose();
            }
            for pair in &pivot.pairs {
                let (a, b) = (&self.blocks[pivot.later[pair.i].1], &self.blocks[pivot.later[pair.j].1]);
                let change = a * inverse * b.transpose();
                self.blocks[pair.block] -= if pair.transposed { change.transpose() } else { change };
            }
        }
        Some(())
    }

    /// Solves in place: right-hand side by node → solution.
    pub fn solve(&self, values: &mut [Vector6<f64>]) {
        for pivot in &self.pivots {
            let scaled = self.diagonal[pivot.node] * values[pivot.node];
            for &(other, block) in &pivot.later {
                values[other] -= self.blocks[block] * scaled;
            }
        }
        for pivot in self.pivots.iter().rev() {
            let mut value = values[pivot.node];
            for &(other, block) in &pivot.later {
                value -= self.blocks[block].tr_mul(&values[other]);
            }
            values[pivot.node] = self.diagonal[pivot.node] * value;
        }
    }
}

/// The block that couples `row` to `column`, and whether it is transposed.
fn find(numbers: &std::collections::HashMap<(usize, usize), usize>, row: usize, column: usize) -> (usize, bool) {
    match numbers.get(&(row, column)) {
        Some(&number) => (number, false),
        None => (numbers[&(column, row)], true),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;

    /// Numbers in -1…1 that look random.
    fn numbers() -> impl FnMut() -> f64 {
        let mut state = 1u32;
        move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1u32 << 23) - 1.0
        }
    }

    #[test]
    fn factors_solve_what_the_dense_matrix_solves() {
        // Two loops that share a body, a branch and a joint to the ground.
        let couplings =
            [(0, 5), (1, 5), (1, 6), (2, 6), (2, 7), (0, 7), (2, 8), (3, 8), (3, 9), (1, 9), (4, 10), (2, 10), (4, 11)];
        let (n_bodies, n_joints) = (5, 7);
        let mut next = numbers();
        let mut factor = Factor::new(n_bodies, n_joints, &couplings).expect("it is small");
        let n = 6 * (n_bodies + n_joints);
        let mut dense = DMatrix::zeros(n, n);
        for node in 0..n_bodies + n_joints {
            let sign = if node < n_bodies { 1.0 } else { -1e-6 };
            let block = Matrix6::from_diagonal(&Vector6::from_fn(|_, _| sign * (1.5 + next())));
            factor.diagonal[node] = block;
            dense.view_mut((6 * node, 6 * node), (6, 6)).copy_from(&block);
        }
        for (index, &(body, joint)) in couplings.iter().enumerate() {
            let block = Matrix6::from_fn(|_, _| next());
            factor.couple(index, &block);
            dense.view_mut((6 * joint, 6 * body), (6, 6)).copy_from(&block);
            dense.view_mut((6 * body, 6 * joint), (6, 6)).copy_from(&block.transpose());
        }
        let right = DVector::from_fn(n, |_, _| next());
        let mut values: Vec<_> = right.as_slice().chunks(6).map(Vector6::from_column_slice).collect();
        factor.factor().expect("quasi-definite");
        factor.solve(&mut values);
        let solution = DVector::from_iterator(n, values.iter().flat_map(|value| value.iter().copied()));
        let error = (&dense * &solution - &right).amax();
        assert!(error < 1e-6 * solution.amax().max(1.0), "{error} of {}", solution.amax());
    }

    #[test]
    fn trees_have_no_fill() {
        // A star of chains: as many blocks as couplings.
        let mut couplings = Vec::new();
        let n_bodies = 31;
        for body in 1..n_bodies {
            let parent = if body % 3 == 1 { 0 } else { body - 1 };
            couplings.extend([(parent, n_bodies + body - 1), (body, n_bodies + body - 1)]);
        }
        let factor = Factor::new(n_bodies, n_bodies - 1, &couplings).expect("it is small");
        assert_eq!(factor.blocks.len(), couplings.len());
        assert!(factor.pivots.iter().all(|pivot| pivot.later.len() <= 1));
    }
}
