"""From files to clean signals in the frames of this project: what several data sets need."""
