"use strict";
// Headings, sentences, tables and pictures that a sheet holds as data.
