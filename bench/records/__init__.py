"""What a run leaves on disk, and how it is checked, found again and handed on."""
