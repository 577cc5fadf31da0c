//! NumPy arrays that the simulation writes or reads.

use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::IntoPyDict;

use crate::errors;

/// An array of a fixed size. Python gets views of it, whose shape and type may be changed without any effect here.
pub struct Buffer {
    array: Py<PyAny>,
    view: Py<PyAny>,
}

impl Buffer {
    /// Zeros that Python may only read.
    pub fn state<T: Element>(py: Python<'_>, shape: &[usize]) -> PyResult<Self> {
        let buffer = Self::new(py, PyArrayDyn::<T>::zeros(py, shape, false))?;
        buffer.view.bind(py).call_method("setflags", (), Some(&[("write", false)].into_py_dict(py)?))?;
        Ok(buffer)
    }

    /// Copies of `row` (or of one number) that Python may write.
    pub fn command<T: Element + Copy>(py: Python<'_>, shape: &[usize], row: &[T]) -> PyResult<Self> {
        let array = PyArrayDyn::<T>::zeros(py, shape, false);
        for (place, value) in array.readwrite().as_slice_mut()?.iter_mut().zip(row.iter().cycle()) {
            *place = *value;
        }
        Self::new(py, array)
    }

    fn new<T: Element>(py: Python<'_>, array: Bound<'_, PyArrayDyn<T>>) -> PyResult<Self> {
        let view = array.call_method0("view")?.unbind();
        let array = array.into_any().unbind();
        let _ = py;
        Ok(Self { array, view })
    }

    /// What Python gets: always the same object.
    pub fn view(&self, py: Python<'_>) -> Py<PyAny> {
        self.view.clone_ref(py)
    }

    /// Lets `fill` overwrite the numbers.
    pub fn write<T: Element>(&self, py: Python<'_>, fill: impl FnOnce(&mut [T])) -> PyResult<()> {
        let array = self.array.bind(py).cast::<PyArrayDyn<T>>()?;
        fill(array.try_readwrite()?.as_slice_mut()?);
        Ok(())
    }

    /// The numbers, `count` of them, borrowed.
    pub fn numbers<'py, T: Element>(&self, py: Python<'py>, count: usize) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
        let array = self.array.bind(py).cast::<PyArrayDyn<T>>()?;
        let numbers = array.try_readonly()?;
        let len = numbers.as_slice()?.len();
        if len != count {
            let problem = format!("an array of commands was resized: it holds {len} numbers, not {count}");
            return Err(errors::invalid_command(py, problem));
        }
        Ok(numbers)
    }

    /// Lets `take` read all numbers, however many there are.
    pub fn read_all<T: Element, R>(&self, py: Python<'_>, take: impl FnOnce(&[T]) -> R) -> PyResult<R> {
        let array = self.array.bind(py).cast::<PyArrayDyn<T>>()?;
        let numbers = array.try_readonly()?;
        Ok(take(numbers.as_slice()?))
    }

    /// Overwrites the numbers with `values`.
    pub fn write_all<T: Element + Copy>(&self, py: Python<'_>, values: &[T]) -> PyResult<()> {
        self.write(py, |numbers| numbers.iter_mut().zip(values).for_each(|(to, from)| *to = *from))
    }
}
