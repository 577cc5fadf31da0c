use std::time::Duration;

use nusb::transfer::{Buffer, Bulk, ControlOut, ControlType, In, Out, Recipient, TransferError};
use nusb::{DeviceInfo, Endpoint, ErrorKind, Interface, MaybeFuture};
use rustix::fs::Access;
use rustix::io::Errno;

use crate::transport::{Bus, Port, TransportError, PACKET};

const VENDOR: u16 = 0x0403;
const PRODUCT: u16 = 0xCB48;
const INTERFACE: u8 = 0;
const BULK_OUT: u8 = 0x02;
const BULK_IN: u8 = 0x81;

/// IN requests that wait in the kernel: the chip always finds one, also while a packet is being read.
const QUEUED: usize = 2;

const CONTROL_TIMEOUT: Duration = Duration::from_millis(500);

/// The computer's USB.
#[derive(Debug, Clone, Copy, Default)]
pub struct Usb;

impl Usb {
    fn falcons() -> Result<impl Iterator<Item = DeviceInfo>, TransportError> {
        let devices = nusb::list_devices().wait()?;
        Ok(devices.filter(|device| device.vendor_id() == VENDOR && device.product_id() == PRODUCT))
    }
}

/// Bus and ports on the way to the device, as `3-1.4`: the name that Linux uses too. Falcons have no serial number of
/// their own.
fn identity(device: &DeviceInfo) -> String {
    let ports: Vec<String> = device.port_chain().iter().map(u8::to_string).collect();
    let bus = device.bus_id().trim_start_matches('0');
    format!("{bus}-{}", ports.join("."))
}

impl Bus for Usb {
    fn list(&self) -> Result<Vec<String>, TransportError> {
        let mut identities: Vec<String> = Self::falcons()?.map(|device| identity(&device)).collect();
        identities.sort();
        Ok(identities)
    }

    fn may_open(&self, wanted: &str) -> Result<(), TransportError> {
        let device = Self::falcons()?.find(|device| identity(device) == wanted).ok_or(TransportError::Gone)?;
        // Where Linux has the files that programs open; a system that keeps them elsewhere says so at opening only.
        let file = format!("/dev/bus/usb/{:03}/{:03}", device.busnum(), device.device_address());
        match rustix::fs::access(&file, Access::READ_OK | Access::WRITE_OK) {
            Err(Errno::ACCESS | Errno::PERM) => Err(TransportError::Denied),
            _ => Ok(()),
        }
    }

    fn open(&self, wanted: &str) -> Result<Box<dyn Port>, TransportError> {
        let device = Self::falcons()?.find(|device| identity(device) == wanted).ok_or(TransportError::Gone)?;
        // Linux gives the chip to its serial driver if that knows the product.
        let interface = device.open().wait()?.detach_and_claim_interface(INTERFACE).wait()?;
        let output = interface.endpoint(BULK_OUT)?;
        let input = interface.endpoint(BULK_IN)?;
        Ok(Box::new(UsbPort { interface, output, input, spare: Some(Buffer::new(PACKET)) }))
    }
}

struct UsbPort {
    interface: Interface,
    output: Endpoint<Bulk, Out>,
    input: Endpoint<Bulk, In>,
    /// Memory of the next OUT transfer; `None` while one is under way.
    spare: Option<Buffer>,
}

impl Port for UsbPort {
    fn control_out(&mut self, request: u8, value: u16) -> Result<(), TransportError> {
        let control = ControlOut {
            control_type: ControlType::Vendor,
            recipient: Recipient::Device,
            request,
            value,
            index: 0,
            data: &[],
        };
        Ok(self.interface.control_out(control, CONTROL_TIMEOUT).wait()?)
    }

    fn bulk_out(&mut self, bytes: &[u8], timeout: Duration) -> Result<(), TransportError> {
        let mut buffer = match self.spare.take() {
            Some(buffer) if buffer.capacity() >= bytes.len() => buffer,
            _ => Buffer::new(bytes.len().max(PACKET)),
        };
        buffer.clear();
        buffer.extend_from_slice(bytes);
        let completion = self.output.transfer_blocking(buffer, timeout);
        self.spare = Some(completion.buffer);
        Ok(completion.status?)
    }

    fn bulk_in(&mut self, packet: &mut [u8; PACKET], timeout: Duration) -> Result<usize, TransportError> {
        while self.input.pending() < QUEUED {
            self.input.submit(Buffer::new(PACKET));
        }
        let Some(completion) = self.input.wait_next_complete(timeout) else { return Ok(0) };
        completion.status?;
        let length = completion.buffer.len().min(PACKET);
        packet[..length].copy_from_slice(&completion.buffer[..length]);
        self.input.submit(completion.buffer);
        Ok(length)
    }
}

impl From<nusb::Error> for TransportError {
    fn from(error: nusb::Error) -> Self {
        match error.kind() {
            ErrorKind::Disconnected | ErrorKind::NotFound => Self::Gone,
            ErrorKind::PermissionDenied => Self::Denied,
            ErrorKind::Busy => Self::Busy,
            _ => Self::Other(error.to_string()),
        }
    }
}

impl From<TransferError> for TransportError {
    fn from(error: TransferError) -> Self {
        match error {
            TransferError::Cancelled => Self::TimedOut,
            TransferError::Disconnected => Self::Gone,
            error => Self::Other(error.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bus_without_falcons_says_so() {
        // Computers without USB have nothing to list at all.
        match Usb.list() {
            Ok(identities) => assert!(identities.iter().all(|identity| identity.contains('-'))),
            Err(error) => assert!(matches!(error, TransportError::Other(_)), "{error}"),
        }
        assert!(Usb.open("0-0").is_err());
    }

    #[test]
    fn unplugged_is_told_from_slow() {
        assert_eq!(TransportError::from(TransferError::Disconnected), TransportError::Gone);
        assert_eq!(TransportError::from(TransferError::Cancelled), TransportError::TimedOut);
        assert!(matches!(TransportError::from(TransferError::Stall), TransportError::Other(_)));
    }
}
