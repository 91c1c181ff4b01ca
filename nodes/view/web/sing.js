// "Make it sing": a law past its edge, and beside it another one, under the same hand, that rests.
import { figure, fixed, unbroken } from "./format.js";

export class Sing {
  constructor({ button, told, beyond }, ask) {
    Object.assign(this, { button, told, facts: null });
    button.addEventListener("click", async () => {
      button.disabled = true;
      const answer = await ask({ op: "sing" });
      button.disabled = false;
      if (answer.ok) {
        this.facts = answer.result;
        // A is past its edge now, so the dials show what lies there.
        beyond.checked = true;
        beyond.dispatchEvent(new Event("change"));
      }
      this.show(null);
    });
  }

  start(hello) {
    this.button.hidden = !hello.sings;
    this.facts = null;
    this.show(null);
  }

  // Say what both do, by what was detected; nothing once a law or its stiffness is another one.
  status({ sings }, law, stiffness, beside) {
    const { facts } = this;
    if (!facts) return;
    if (law !== facts.law || stiffness !== facts.stiffness || beside !== facts.beside) this.facts = null;
    this.show(sings);
  }

  show(sings) {
    const { facts, told } = this;
    told.hidden = facts === null;
    if (!facts) return;
    const times = facts.times === 1 ? "as stiff" : `${["", "", "twice", "three times"][facts.times]} as stiff`;
    const late = `The answer comes ${fixed(facts.delay, 1)} ticks late.`;
    const one = `A, ${facts.law} at ${figure(facts.stiffness)} N/m (edge ${figure(facts.edge)}), ${sings?.a ? sings.a.replace("It rings", "sings") : "is pressed"}.`;
    const two = `B, ${facts.beside} at ${figure(facts.hardness)} N/m (edge ${figure(facts.besideEdge)}), ${times}, ${sings?.b ? sings.b.replace("It rings", "rings") : sings ? "rests" : "is pressed by the same hand"}.`;
    told.textContent = unbroken(`${late} ${one} ${two}`);
  }
}
