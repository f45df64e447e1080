"""An aircraft that a radar loses where it flies across the line of sight, and the same tracker on plots of the user's."""
