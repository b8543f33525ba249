"""Records: written so that a power cut takes little, read, repaired, replayed and reprocessed."""
