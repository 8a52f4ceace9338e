"""The adapter `yarp`: ports of a YARP network."""

from uwserver_adapters.yarp.adapter import YarpAdapter

__all__ = ["YarpAdapter"]
