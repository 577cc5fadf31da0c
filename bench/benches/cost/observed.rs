//! What the C++ program cost when it was observed: another run, on another day, with other threads on. For orientation
//! only.

/// µs a step of 1 ms, headless, communication on, with ROS.
pub fn step_us(scene: &str) -> Option<f64> {
    let known = [
        ("boxes1", 5.7),
        ("boxes10", 32.0),
        ("boxes50", 323.0),
        ("boxes100", 669.0),
        ("boxes200", 1382.0),
        ("pendulum", 3.8),
        ("chain", 14.0),
        ("stack", 60.0),
        ("blender-toy-car", 13.0),
        ("blender-toy-car2", 28.0),
        ("blender-raven2", 29.0),
        ("blender-mtm", 19.0),
        ("blender-psm", 34.0),
        ("blender-ecm", 25.0),
        ("blender-kuka-lbr-med", 31.0),
        ("blender-pr2", 191.0),
        ("puzzle1", 94.0),
        ("puzzle4", 350.0),
        ("puzzle5", 188.0),
        ("puzzle6", 188.0),
    ];
    known.iter().find(|(name, _)| *name == scene).map(|known| known.1)
}

/// Peak memory without windows, MB.
pub fn peak_memory_mb(scene: &str) -> Option<f64> {
    match scene {
        "pendulum" => Some(134.0),
        "blender-kuka-lbr-med" => Some(174.0),
        "blender-raven2" => Some(292.0),
        _ => None,
    }
}

/// A value for a table, or a dash.
pub fn cell(value: Option<f64>) -> String {
    value.map_or_else(|| "–".into(), |value| value.to_string())
}
