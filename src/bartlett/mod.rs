//! Bartlett profiles and bearings (in work).
