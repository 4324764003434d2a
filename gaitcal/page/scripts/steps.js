"use strict";
// The table of steps and phases.
