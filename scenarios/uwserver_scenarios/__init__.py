"""Shipped scenarios, vehicles and devices, as TOML files beside this one."""
