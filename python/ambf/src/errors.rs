//! Exceptions. Their classes are Python's, in `ambf.errors`.

use ambf_core::bullet::StateError;
use ambf_core::scene::{ParameterError, SetStateError};
use ambf_core::sim::{LostState, ModelError};
use ambf_core::text::lines;
use ambf_render::{NoSuchCamera, RenderError};
use ambf_viewer::ViewerError;
use pyo3::call::PyCallArgs;
use pyo3::prelude::*;

fn raise<'py>(py: Python<'py>, class: &str, arguments: impl PyCallArgs<'py>) -> PyErr {
    let made = py.import("ambf.errors").and_then(|module| module.getattr(class)?.call1(arguments));
    made.map_or_else(|error| error, PyErr::from_value)
}

/// Error when the scene can't be used; one sentence a problem, each with its place in a file.
pub fn load(py: Python<'_>, problems: Vec<String>) -> PyErr {
    let problems: Vec<String> = problems.iter().map(|problem| lines(problem).into_owned()).collect();
    raise(py, "LoadError", (problems,))
}

/// Error when a state became infinite or not a number.
pub fn non_finite(py: Python<'_>, problem: &LostState) -> PyErr {
    let LostState { body, joint, step, command, .. } = problem;
    raise(py, "NonFiniteError", (lines(&problem.to_string()).into_owned(), body, joint, step, command))
}

/// Error when a command can't be used; nothing has moved.
pub fn invalid_command(py: Python<'_>, message: String) -> PyErr {
    raise(py, "InvalidCommand", (lines(&message).into_owned(),))
}

/// Error when a closed simulation is used.
pub fn closed(py: Python<'_>) -> PyErr {
    raise(py, "ClosedError", ("the simulation is closed",))
}

/// Error when a simulation is used while another thread steps it.
pub fn busy(py: Python<'_>) -> PyErr {
    raise(py, "BusyError", ("another thread is stepping this simulation",))
}

/// Error when a state can't be saved or restored.
pub fn state(py: Python<'_>, problem: &StateError) -> PyErr {
    let message = match problem {
        StateError::NotSavable => "the simulation can't save states: make it with saving=True".into(),
        _ => problem.to_string(),
    };
    raise(py, "StateError", (message,))
}

/// Error when a state can't be set; nothing has changed.
pub fn set_state(py: Python<'_>, problem: &SetStateError) -> PyErr {
    raise(py, "StateError", (lines(&problem.to_string()).into_owned(),))
}

/// Error when a state can't be set, in words.
pub fn refused(py: Python<'_>, problem: &str) -> PyErr {
    raise(py, "StateError", (lines(problem).into_owned(),))
}

/// Error when a parameter can't be changed; nothing has changed.
pub fn parameter(problem: &ParameterError) -> PyErr {
    pyo3::exceptions::PyValueError::new_err(lines(&problem.to_string()).into_owned())
}

/// Error when a model is not added or removed; nothing has changed.
pub fn model(py: Python<'_>, problem: &ModelError) -> PyErr {
    let message = lines(&problem.to_string()).into_owned();
    match problem {
        ModelError::Unknown { .. } => raise(py, "NotFoundError", (message,)),
        _ => raise(py, "LoadError", (vec![message],)),
    }
}

/// Error when a recording can't be written, read or replayed.
pub fn recording(py: Python<'_>, problem: &str) -> PyErr {
    raise(py, "RecordingError", (lines(problem).into_owned(),))
}

/// Error when bodies are no tree, or joints that follow others can't be within their limits.
pub fn tree(py: Python<'_>, problem: &str) -> PyErr {
    raise(py, "TreeError", (lines(problem).into_owned(),))
}

/// Error when there is no such camera, or several.
pub fn camera(py: Python<'_>, problem: &NoSuchCamera) -> PyErr {
    raise(py, "NotFoundError", (lines(&problem.to_string()).into_owned(),))
}

/// Error when nothing can be drawn; a size that cannot be is a `ValueError`.
pub fn render(py: Python<'_>, problem: &RenderError) -> PyErr {
    match problem {
        RenderError::Size { .. } => pyo3::exceptions::PyValueError::new_err(problem.to_string()),
        _ => raise(py, "RenderError", (problem.to_string(),)),
    }
}

/// Error when there are no windows.
pub fn view(py: Python<'_>, problem: &ViewerError) -> PyErr {
    let message = match problem {
        ViewerError::NoDisplay => {
            "there is no display to open windows on: set DISPLAY (or WAYLAND_DISPLAY), or use render(), which needs none".into()
        }
        ViewerError::Failed(why) => format!("windows cannot be opened: {why}; render() draws without"),
        _ => problem.to_string(),
    };
    raise(py, "RenderError", (message,))
}

/// Error when there is nothing of that name.
pub fn not_found(py: Python<'_>, message: &str) -> PyErr {
    raise(py, "NotFoundError", (lines(message).into_owned(),))
}
