"""`WatchDog` under the name that scripts of the C++ simulator import it by."""

from ambf_client.watch_dog import WatchDog

__all__ = ["WatchDog"]
