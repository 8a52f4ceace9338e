"""Manoeuvres of one vehicle, run open loop in still water, and the report on them, which `uwserver manoeuvres` prints."""
