"""Contact sensors."""

from __future__ import annotations

from typing import List, Optional

from ambf_msgs.msg import ContactEvent, ContactSensorCmd, ContactSensorState
from std_msgs.msg import String

from .base_object import BaseObject
from .ros_abstraction_layer import ral_may_come_first


class ContactSensor(BaseObject):
    """A contact sensor: one event for each rigid body that touches the sensor's body. It has no pose and no commands."""

    _HAS_POSE_COMMAND = False

    @ral_may_come_first
    def __init__(self, a_name: str, time_out: float = 0.1) -> None:
        super().__init__(a_name, time_out, ContactSensorState(), ContactSensorCmd())
        self.object_type = "CONTACT_SENSOR"

    def get_type(self) -> str:
        """`CONTACT`."""
        return str(self._state.type.data)

    def get_parent(self) -> String:
        """Name of the parent body: a `std_msgs/String`."""
        return self._state.parent_name

    def get_num_contact_events(self) -> int:
        """Number of bodies that touch."""
        return len(self._state.contact_events)

    def get_contact_event(self, i: int) -> Optional[ContactEvent]:
        """Event `i`, an `ambf_msgs/ContactEvent`; None if there is no such event.

        Its `contact_data`, one entry a contact point, is empty unless the sensor's block has `process contact details: true`:
        `distance.data`, m, is negative where the bodies overlap; `contact_point`, m, and `contact_normal`, of unit length and towards the
        sensor's body, are in world axes.
        """
        events = self._state.contact_events
        return events[i] if 0 <= i < len(events) else None

    def get_all_contact_events(self) -> List[ContactEvent]:
        """All events; see `get_contact_event`."""
        return list(self._state.contact_events)

    def get_contact_object_name(self, i: int) -> Optional[str]:
        """Identifier (namespace and key) of the body of event `i`; None if there is no such event."""
        event = self.get_contact_event(i)
        return None if event is None else str(event.object_name.data)

    def get_all_contact_object_names(self) -> List[str]:
        """Identifiers (namespace and key) of all bodies that touch."""
        return [str(event.object_name.data) for event in self._state.contact_events]
