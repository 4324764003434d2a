"use strict";
// The page on paper.
