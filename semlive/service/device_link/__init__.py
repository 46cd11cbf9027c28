"""Link to one device: requests of control, the thread that alone calls the driver, supervision of the readings, and stops."""

from semlive.service.device_link.link import DeviceLink

__all__ = ["DeviceLink"]
