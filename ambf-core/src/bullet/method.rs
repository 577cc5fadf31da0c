/// Method that solves contacts and constraints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Solver {
    /// Sequential impulses, the default.
    #[default]
    SequentialImpulse,
    /// Nonlinear nonsmooth conjugate gradients.
    Nncg,
    /// Dantzig's direct solver of the mixed linear complementarity problem.
    Dantzig,
    /// Projected Gauss-Seidel on the mixed linear complementarity problem.
    ProjectedGaussSeidel,
    /// Lemke's pivoting solver.
    Lemke,
    /// Sequential impulses that start friction from the impulses of the step before, as the Bullet of the C++ program did.
    WarmFriction,
}

impl Solver {
    /// All of them, with the names by which users choose.
    pub const NAMES: [(&'static str, Self); 6] = [
        ("si", Self::SequentialImpulse),
        ("nncg", Self::Nncg),
        ("dantzig", Self::Dantzig),
        ("pgs", Self::ProjectedGaussSeidel),
        ("lemke", Self::Lemke),
        ("si-warm", Self::WarmFriction),
    ];

    /// The solver called `name`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(known, _)| *known == name).map(|&(_, solver)| solver)
    }
}

/// How bodies without contacts and constraints are moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Integrator {
    /// Bullet's semi-implicit Euler, first order in the sub-step. The default.
    #[default]
    Euler,
    /// The same velocities, with positions that are exact under constant force.
    Ballistic,
}

impl Integrator {
    /// Both, with the names by which users choose.
    pub const NAMES: [(&'static str, Self); 2] = [("euler", Self::Euler), ("ballistic", Self::Ballistic)];

    /// The integrator called `name`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(known, _)| *known == name).map(|&(_, integrator)| integrator)
    }
}
