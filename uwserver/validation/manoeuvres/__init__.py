"""Manoeuvres of one vehicle, run open loop in still water, and the report of them: what `uwserver manoeuvres` tells."""
