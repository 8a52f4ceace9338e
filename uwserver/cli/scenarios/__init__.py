"""Commands about scenario, vehicle and device files: check, list, schema, camera-info, new, show and copy."""
