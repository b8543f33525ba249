"""The grade map: the slope of a line's tracks, with its deviation, from many rides."""
