"""The vehicle's side: what ground stations see and want."""
