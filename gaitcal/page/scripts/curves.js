"use strict";
// All plots of a preset.
