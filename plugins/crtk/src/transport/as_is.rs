//! Messages whose header is sent as it is: rosrust replaces a stamp of 0, which says that the data are not valid now, by
//! the time of sending.

use std::io::{self, Read, Write};

use rosrust::{Message as RosMessage, RosMsg};

/// A message that rosrust does not change.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct AsIs<M>(pub M);

impl<M: RosMessage> RosMsg for AsIs<M> {
    fn encode<W: Write>(&self, bytes: W) -> io::Result<()> {
        self.0.encode(bytes)
    }

    fn decode<R: Read>(bytes: R) -> io::Result<Self> {
        M::decode(bytes).map(Self)
    }
}

/// Without a `set_header` of its own: the trait's does nothing.
impl<M: RosMessage> RosMessage for AsIs<M> {
    fn msg_definition() -> String {
        M::msg_definition()
    }

    fn md5sum() -> String {
        M::md5sum()
    }

    fn msg_type() -> String {
        M::msg_type()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry_msgs::PoseStamped;

    #[test]
    fn the_type_and_the_bytes_are_those_of_the_message() {
        let mut message = PoseStamped::default();
        message.header.frame_id = "base".into();
        assert_eq!(AsIs(message.clone()).encode_vec().unwrap(), message.encode_vec().unwrap());
        assert_eq!(AsIs::<PoseStamped>::md5sum(), PoseStamped::md5sum());
        assert_eq!(AsIs::<PoseStamped>::msg_type(), "geometry_msgs/PoseStamped");
    }
}
