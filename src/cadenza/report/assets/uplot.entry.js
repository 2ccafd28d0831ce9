/*! uPlot 1.6.32, copyright 2022 Leon Sorokin, MIT License */
// What the charts are drawn with; README.md says how uplot.min.js and uplot.min.css are made.
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";

window.uPlot = uPlot;
