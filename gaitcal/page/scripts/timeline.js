"use strict";
// Strikes, toe-offs, stance and validity of each leg along time.
