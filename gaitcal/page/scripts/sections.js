"use strict";
// The tables of each preset.
