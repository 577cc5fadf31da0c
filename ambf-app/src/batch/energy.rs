//! The energy ledger of a run as comma-separated values.

use std::io::Write;
use std::path::Path;

use ambf_core::bullet::EnergyLedger;
use ambf_core::files::{folder_for, Output, WriteError};
use ambf_core::sim::Simulation;

/// Writes one row a step: `sim_step`, `sim_time` in s, then the numbers of [`EnergyLedger`] in J.
pub struct EnergyWriter(Output);

impl EnergyWriter {
    /// Begins the file with its heading and switches the ledger of the simulation on.
    ///
    /// # Errors
    /// When the file or its folder cannot be made.
    pub fn create(path: &Path, simulation: &mut Simulation) -> Result<Self, WriteError> {
        folder_for(path)?;
        let mut output = Output::create(path)?;
        output.add(|out| writeln!(out, "sim_step,sim_time_s,{}", EnergyLedger::NAMES.join(",")))?;
        simulation.set_energy_ledger(true);
        Ok(Self(output))
    }

    /// Writes the present ledger as the row of step `step`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&mut self, simulation: &Simulation, step: u64) -> Result<(), WriteError> {
        self.0.add(|out| {
            write!(out, "{step},{}", simulation.sim_time())?;
            for value in simulation.energy().values() {
                write!(out, ",{value:e}")?;
            }
            writeln!(out)
        })
    }

    /// Completes the file.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(self) -> Result<(), WriteError> {
        self.0.finish()
    }
}
