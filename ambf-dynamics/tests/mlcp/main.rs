//! The solver of mixed linear complementarity problems against definitions, enumeration and dense algebra.

mod budget;
mod case;
mod definition;
mod energy;
mod interface;
mod islands;
mod positions;
mod scenes;
