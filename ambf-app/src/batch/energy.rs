//! The energy ledger of a run as comma-separated values.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use ambf_core::bullet::EnergyLedger;
use ambf_core::sim::Simulation;

/// Writes one row a step: `sim_step`, `sim_time` in s, then the numbers of [`EnergyLedger`] in J.
pub struct EnergyWriter(BufWriter<File>);

impl EnergyWriter {
    /// Creates the file with its heading and switches the ledger of the simulation on.
    ///
    /// # Errors
    /// When the file or its folder cannot be made.
    pub fn create(path: &Path, simulation: &mut Simulation) -> io::Result<Self> {
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder)?;
        }
        let mut writer = BufWriter::new(File::create(path)?);
        writeln!(writer, "sim_step,sim_time_s,{}", EnergyLedger::NAMES.join(","))?;
        simulation.set_energy_ledger(true);
        Ok(Self(writer))
    }

    /// Writes the present ledger as the row of step `step`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&mut self, simulation: &Simulation, step: u64) -> io::Result<()> {
        write!(self.0, "{step},{}", simulation.sim_time())?;
        for value in simulation.energy().values() {
            write!(self.0, ",{value:e}")?;
        }
        writeln!(self.0)
    }

    /// Writes what is left.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(mut self) -> io::Result<()> {
        self.0.flush()
    }
}
