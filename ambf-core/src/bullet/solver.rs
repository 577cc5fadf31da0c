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
    /// Sequential impulses with warm-started friction, as in the Bullet version of the C++ program.
    WarmFriction,
    /// Direct solution of every island for which the cost is within the budget, else sequential impulses with the
    /// corrections of [`AccurateSettings`](super::AccurateSettings).
    Accurate,
}

impl Solver {
    /// All of them, with the names by which users choose.
    pub const NAMES: [(&'static str, Self); 7] = [
        ("si", Self::SequentialImpulse),
        ("nncg", Self::Nncg),
        ("dantzig", Self::Dantzig),
        ("pgs", Self::ProjectedGaussSeidel),
        ("lemke", Self::Lemke),
        ("si-warm", Self::WarmFriction),
        ("accurate", Self::Accurate),
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, solver)| *solver == self).map_or("", |(name, _)| name)
    }
}

/// Integrator of free bodies: those without contacts and constraints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Integrator {
    /// Bullet's semi-implicit Euler, first order in the sub-step. The default.
    #[default]
    Euler,
    /// The same velocities, with positions that are exact under constant force.
    Ballistic,
    /// Positions and velocities that are exact under constant force and damping; rotation by Euler's equations and the
    /// classical Runge-Kutta method.
    RungeKutta,
}

impl Integrator {
    /// All of them, with the names by which users choose.
    pub const NAMES: [(&'static str, Self); 3] =
        [("euler", Self::Euler), ("ballistic", Self::Ballistic), ("rk4", Self::RungeKutta)];

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, integrator)| *integrator == self).map_or("", |(name, _)| name)
    }
}
