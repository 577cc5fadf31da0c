//! NumPy arrays that the simulation writes or reads.

use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyReadwriteArray1};
use parking_lot::Mutex;
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

/// Arrays that are kept of a kind: who asks for a picture often holds the one before.
const MAX_KEPT: usize = 3;

/// Arrays whose memory is used again when Python has dropped them: giving a program new memory takes the system as long
/// as half of a small picture.
#[derive(Default)]
pub struct Pool(Mutex<Vec<Py<PyAny>>>);

impl Pool {
    /// An array of `length` numbers of any value that nobody else has. Python must get views of it only.
    #[allow(deprecated)] // without `get_refcnt` the count is read by an unsafe function
    pub fn array<'py, T: Element>(&self, py: Python<'py>, length: usize) -> PyResult<PyReadwriteArray1<'py, T>> {
        let kept = || self.0.lock();
        // Below a view Python may have changed anything.
        let fits = |array: &Py<PyAny>| {
            let numbers = array.bind(py).cast::<PyArray1<T>>().ok().and_then(|array| array.try_readwrite().ok());
            numbers.is_some_and(|mut numbers| numbers.as_slice_mut().is_ok_and(|numbers| numbers.len() == length))
        };
        // Not under the lock: making an array may run Python's code.
        let mut arrays = std::mem::take(&mut *kept());
        let array = match arrays.iter().position(|array| array.get_refcnt(py) == 1 && fits(array)) {
            Some(place) => arrays.remove(place).into_bound(py),
            None => PyArray1::<T>::zeros(py, length, false).into_any(),
        };
        arrays.insert(0, array.clone().unbind());
        arrays.truncate(MAX_KEPT);
        *kept() = arrays;
        Ok(array.cast::<PyArray1<T>>()?.try_readwrite()?)
    }
}
