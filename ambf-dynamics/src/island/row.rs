//! Rows of an island as they are given.

/// What a row is of.
#[repr(u8)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Kind {
    /// A joint of rigid bodies: constraint, limit, motor or spring.
    #[default]
    Joint = 0,
    /// A coupling of joints of rigid bodies.
    Coupling = 1,
    /// A joint of an articulation, or a joint or drive that acts on one.
    ArticulatedJoint = 2,
    /// A contact.
    Contact = 3,
    /// Friction, of any kind, of a contact.
    Friction = 4,
}

/// A row of an island without its sides. What a kind of rows does not have is 0 or false.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// What it is of.
    pub kind: Kind,
    /// Whether it acts on an articulation: its softness is then of at least the inverse mass of the link.
    pub is_articulated: bool,
    /// Whether its velocity is in rad/s.
    pub is_angular: bool,
    /// Joints: whether it constrains a position; false: a motor or spring.
    pub is_geometric: bool,
    /// Joints: whether it is a spring, which resists corrections.
    pub is_spring: bool,
    /// Joints of rigid bodies: whether it is a limit, and one that is not reached.
    pub is_limit: bool,
    /// See [`is_limit`](Self::is_limit).
    pub is_open: bool,
    /// Joints of rigid bodies: whether `guess` is the impulse of the last sub-step.
    pub is_known: bool,
    /// Contacts: whether it was there in the last sub-step, and open.
    pub was_open: bool,
    /// Joints of rigid bodies: number of the joint; its rows follow each other.
    pub joint: u32,
    /// Friction: index of the contact's row.
    pub normal: i32,
    /// Effective mass as Bullet has it, kg or kg·m²: the inverse of the diagonal J M⁻¹ Jᵀ, in soft rows with their CFM; 0:
    /// nothing moves.
    pub effective_mass: f64,
    /// Masses of the links on which it acts, kg; 0: none.
    pub link_masses: [f64; 2],
    /// Wanted change of velocity, m/s or rad/s.
    pub target: f64,
    /// Velocity bias, see [`mlcp::Row`](crate::mlcp::ConstraintRow::bias).
    pub bias: f64,
    /// CFM that the row has by itself, 1/kg or 1/(kg·m²).
    pub cfm: f64,
    /// Bounds of the impulse, N·s or N·m·s.
    pub low: f64,
    /// See [`low`](Self::low).
    pub high: f64,
    /// Impulse of a drive that is part of the motion before the impulses, N·s or N·m·s.
    pub fed: f64,
    /// Impulse in the last sub-step, N·s or N·m·s, 0: not known; of friction `warm_start` times that.
    pub guess: f64,
    /// Friction: see `guess`, > 0.
    pub warm_start: f64,
    /// Pseudo-velocity that removes the position error in this sub-step, m/s or rad/s; of contacts and joints of
    /// articulations times the effective mass.
    pub correction: f64,
    /// Contacts: distance of the bodies, negative where they penetrate, m.
    pub gap: f64,
    /// Joints of rigid bodies and couplings: what the CFM is in proportion to, 1/kg or 1/(kg·m²).
    pub response: f64,
    /// Joints of rigid bodies: the same in the position problem; found by the island.
    pub position_response: f64,
    /// Joints of rigid bodies: square of the angle by which the bodies turn relative to each other in the sub-step.
    pub turn_squared: f64,
    /// Joints of rigid bodies: their longest lever arm, m; 0: not known.
    pub arm: f64,
    /// Friction: coefficient, or a length, m, for rolling friction; and largest impulse, N·s or N·m·s.
    pub friction: f64,
    /// See [`friction`](Self::friction).
    pub cap: f64,
}

impl Default for Row {
    /// A motor of a joint of rigid bodies that moves nothing.
    fn default() -> Self {
        Self {
            kind: Kind::Joint,
            is_articulated: false,
            is_angular: false,
            is_geometric: false,
            is_spring: false,
            is_limit: false,
            is_open: false,
            is_known: false,
            was_open: false,
            joint: 0,
            normal: -1,
            effective_mass: 0.0,
            link_masses: [0.0; 2],
            target: 0.0,
            bias: 0.0,
            cfm: 0.0,
            low: f64::NEG_INFINITY,
            high: f64::INFINITY,
            fed: 0.0,
            guess: 0.0,
            warm_start: 1.0,
            correction: 0.0,
            gap: 0.0,
            response: 0.0,
            position_response: 0.0,
            turn_squared: 0.0,
            arm: 0.0,
            friction: 0.0,
            cap: f64::INFINITY,
        }
    }
}
