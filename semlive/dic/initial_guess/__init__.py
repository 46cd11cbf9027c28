"""Initial guesses for IC-GN: one shift of the frame, then block matching around it, then a smooth field through the matches.

The frame shift is the peak of a low-passed phase correlation at half resolution. It is correct to a few px for shifts up to half the
frame, because strain, distortion and drift within a frame only broaden the peak. Blocks of 64 px are then searched within 32 px of it
by ZNCC, whose value decides whether a block is accepted.
"""
