//! Every trace of the C++ simulator against our run of the same scene. `docs/parity.md` explains what is left.

mod parity_common;

use std::thread;

use parity_common::{
    at_rest, bodies, cases, compare_bodies, compare_joints, joints, load_case, meta, shared, simulate, Case, Quantity,
    Start,
};

/// The cases that can be compared; none, and a word about it, where the test data is absent.
fn comparable() -> Vec<Case> {
    let Some(shared) = shared() else {
        eprintln!("SKIPPED: no traces in ../shared");
        return Vec::new();
    };
    let (soft, rigid): (Vec<_>, Vec<_>) = cases(&shared).into_iter().partition(Case::is_soft);
    soft.iter().for_each(|case| eprintln!("SKIPPED: {}: soft bodies are not simulated", case.name));
    rigid
}

/// Runs `check` on every case, each in its own thread, and fails with all complaints.
fn for_each(cases: &[Case], check: impl Fn(&Case) -> Vec<String> + Sync) {
    let complaints: Vec<_> = thread::scope(|scope| {
        let threads: Vec<_> = cases.iter().map(|case| (case, scope.spawn(|| check(case)))).collect();
        let results = threads.into_iter().map(|(case, thread)| match thread.join() {
            Ok(complaints) => complaints.iter().map(|text| format!("{}: {text}", case.name)).collect(),
            Err(_) => vec![format!("{}: see the panic above", case.name)],
        });
        results.flat_map(|list: Vec<_>| list).collect()
    });
    assert!(complaints.is_empty(), "\n{}", complaints.join("\n"));
}

#[test]
fn explore() {
    for_each(&comparable(), |case| {
        let (b, j) = (bodies(case), joints(case));
        let steps: Vec<_> = b.rows.iter().map(|row| row.0).collect();
        let ours = simulate(case, &steps, Start::AsWritten);
        let mut out = format!("{} contact {:?}\n", case.name, ours.first_contact);
        for range in [0..=100, 0..=u64::MAX] {
            for q in [Quantity::Position, Quantity::Rotation, Quantity::Linear, Quantity::Angular] {
                out += &format!("   {q:?} {:?}\n", compare_bodies(&ours.bodies, &b, q, range.clone()));
            }
            for q in [Quantity::JointPosition, Quantity::JointVelocity, Quantity::JointEffort] {
                if !j.names.is_empty() {
                    out += &format!("   {q:?} {:?}\n", compare_joints(&ours.joints, &j, q, range.clone()));
                }
            }
        }
        out += &format!("   rest {:?}\n", at_rest(&ours.bodies, &b));
        println!("{out}");
        vec![]
    });
}
