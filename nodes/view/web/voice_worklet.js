// Runs the voice on the audio thread.
import { Voice } from "./voice.js";

registerProcessor("voice", class extends AudioWorkletProcessor {
  constructor() {
    super();
    const voice = this.voice = new Voice(sampleRate);
    this.port.onmessage = ({ data }) => voice.feed(data.times, data.forces);
  }

  process(_, [[block]]) {
    this.voice.fill(block);
    return true;
  }
});
