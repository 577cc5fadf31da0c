//! What a run writes while it steps: traces, the energy ledger, pictures and videos.

use ambf_core::files::WriteError;
use ambf_core::sim::Simulation;

#[cfg(feature = "pictures")]
use super::Pictures;
use super::{BatchError, EnergyWriter, Plan, TraceWriter};
use crate::cli::BatchOptions;

/// All files of a run. What fails to be written is given up; the rest is completed, also when the run ends early.
#[derive(Default)]
pub(super) struct Outputs {
    trace: Option<TraceWriter>,
    energy: Option<EnergyWriter>,
    #[cfg(feature = "pictures")]
    pictures: Option<Pictures>,
    every: u64,
    /// Step after which numbers are written in any case.
    last: u64,
    /// Step after which they were written last.
    written: Option<u64>,
}

impl Outputs {
    /// Begins what `options` ask for. `names` are those of the bodies.
    pub fn create(
        options: &BatchOptions,
        plan: &Plan,
        simulation: &mut Simulation,
        names: Vec<String>,
    ) -> Result<Self, BatchError> {
        let mut outputs = Self { every: options.every, last: plan.steps(), ..Self::default() };
        if let Some(prefix) = &options.trace {
            outputs.trace = Some(TraceWriter::create(prefix, simulation, names, options.full)?);
        }
        if let Some(path) = &options.energy {
            outputs.energy = Some(EnergyWriter::create(path, simulation)?);
        }
        #[cfg(feature = "pictures")]
        if let Some(wanted) = &options.pictures {
            outputs.pictures = Some(Pictures::create(wanted, simulation, plan.mean_dt)?);
        }
        #[cfg(not(feature = "pictures"))]
        if options.pictures.is_some() {
            return Err(BatchError::Usage("--render: this program was built without pictures (feature `view`)".into()));
        }
        Ok(outputs)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        #[cfg(feature = "pictures")]
        let has_pictures = self.pictures.is_some();
        #[cfg(not(feature = "pictures"))]
        let has_pictures = false;
        self.trace.is_none() && self.energy.is_none() && !has_pictures
    }

    /// Writes what is due after `step`.
    pub fn write(&mut self, simulation: &Simulation, step: u64) -> Result<(), BatchError> {
        if step.is_multiple_of(self.every) || step == self.last {
            self.write_numbers(simulation, step)?;
        }
        #[cfg(feature = "pictures")]
        if let Some(pictures) = &mut self.pictures {
            pictures.take(simulation, step)?;
        }
        Ok(())
    }

    /// Says that `last` is the last step, `made` of which were made until now.
    pub fn end_at(&mut self, simulation: &Simulation, last: u64, made: u64) -> Result<(), BatchError> {
        self.last = last;
        match made == last && self.written != Some(made) {
            true => self.write_numbers(simulation, made),
            false => Ok(()),
        }
    }

    fn write_numbers(&mut self, simulation: &Simulation, step: u64) -> Result<(), BatchError> {
        self.written = Some(step);
        add(&mut self.trace, |trace| trace.write(simulation, step))?;
        add(&mut self.energy, |energy| energy.write(simulation, step))?;
        Ok(())
    }

    /// Completes everything; what failed.
    pub fn finish(self) -> Vec<BatchError> {
        let mut failed: Vec<BatchError> = Vec::new();
        failed.extend(self.trace.into_iter().flat_map(TraceWriter::finish).map(BatchError::from));
        failed.extend(self.energy.and_then(|energy| energy.finish().err()).map(BatchError::from));
        #[cfg(feature = "pictures")]
        failed.extend(self.pictures.into_iter().flat_map(Pictures::finish).map(BatchError::from));
        failed
    }
}

/// Lets `output` write; it is dropped when that fails.
fn add<T>(output: &mut Option<T>, write: impl FnOnce(&mut T) -> Result<(), WriteError>) -> Result<(), WriteError> {
    let written = output.as_mut().map_or(Ok(()), write);
    if written.is_err() {
        *output = None;
    }
    written
}
