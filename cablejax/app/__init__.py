"""A page on this machine for one who would rather look than type: scans in, cables seen, measured and handed on."""

from cablejax.app.desk import Desk
from cablejax.app.server import PageServer, serve

__all__ = ["Desk", "PageServer", "serve"]
