//! Scenes that are loaded and stepped: motion, constraints, contacts, commands, saved states. One program, so that they are linked
//! once: `cargo test -p ambf-core --test simulation urdf` runs one file.

mod articulation;
mod assembly;
mod bad_scenes_limits;
mod budgets;
mod couplings;
mod energy;
mod energy_scenes;
mod joint_drives;
mod joint_rows;
mod lost_states;
mod models_at_run_time;
mod physics_churn;
mod physics_collisions;
mod physics_common;
mod physics_control;
mod physics_elements;
mod physics_faults;
mod physics_joints;
mod physics_jumps;
mod physics_meshes;
mod physics_motion;
mod physics_press;
mod physics_sleep;
mod physics_soft_bodies;
mod resets;
mod resources;
mod robot_description;
mod saved_common;
mod saved_states;
mod set_states;
mod shared_worlds;
mod soft_common;
mod stepper;
mod urdf;
mod urdf_physics;
