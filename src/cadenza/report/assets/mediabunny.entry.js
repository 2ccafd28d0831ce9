// What the report page uses of Mediabunny; README.md says how mediabunny.min.js is made from this.
export {
  AudioBufferSource, BufferTarget, CanvasSource, Mp4OutputFormat, Output,
  getFirstEncodableAudioCodec, getFirstEncodableVideoCodec,
} from "mediabunny";
