// The cell: robot, cameras' views, lights and paths in three dimensions, and the images of the cameras beside them.
// The server tells of it only while somebody looks. Frames may come in any order: one that is not known yet waits.
const byId = (id) => document.getElementById(id);
const numbers = (text) => (text ?? "0 0 0").trim().split(/\s+/).map(Number);
const HIDDEN = /^workspace\//;

// Gives back what an object holds of the memory of the graphics.
function dispose({ geometry, material }) {
  geometry?.dispose();
  material?.dispose();
}

export class CellView {
  constructor(canvas, cameras) {
    Object.assign(this, { canvas, cameras, three: null, waiting: [], turn: { azimuth: -1.1, height: 0.42, distance: 6 } });
    this.listen();
  }

  // Loads the library at the first look, once; throws where the browser cannot draw in three dimensions.
  open() {
    this.opened ??= this.load();
    return this.opened;
  }

  async load() {
    const three = await import("/static/three.module.min.js");
    try {
      this.renderer = new three.WebGLRenderer({ canvas: this.canvas, antialias: true, alpha: true });
    } catch (error) {
      this.flat = true;
      this.waiting = [];
      throw error;
    }
    this.three = three;
    this.scene = new three.Scene();
    this.scene.add(new three.HemisphereLight(0xffffff, 0x8899aa, 2.2));
    const sun = new three.DirectionalLight(0xffffff, 1.6);
    sun.position.set(2, -3, 5);
    this.scene.add(sun);
    this.camera = new three.PerspectiveCamera(40, 1, 0.05, 100);
    this.camera.up.set(0, 0, 1);
    this.target = new three.Vector3(0, 0, 0.8);
    this.empty();
    for (const change of this.waiting.splice(0)) this.take(change);
  }

  // Forgets a machine that is gone.
  clear() {
    this.cameras.replaceChildren();
    this.images = new Map();
    this.waiting = [];
    if (this.three) this.empty();
  }

  empty() {
    this.world?.traverse(dispose);
    this.world?.removeFromParent();
    this.world = new this.three.Group();
    this.scene.add(this.world);
    this.frames = new Map([["world", this.world]]);
    this.joints = new Map();
    this.shown = new Map();  // marker -> object
    this.robot = "";
    this.draw();
  }

  take({ part, content }) {
    const [kind, ...rest] = part.split("/"), name = rest.join("/");
    if (kind === "image" || kind === "spot") { this.show(name, kind, content); return; }
    if (rest[0] === "residuals" && content) this.show(content.frame.replace(/_optical_frame$/, ""), "residuals", content.text);
    if (!this.three) { if (!this.flat) this.waiting.push({ part, content }); return; }
    switch (kind) {
      case "robot": if (content) this.build(content); break;
      case "joints":
        for (const [joint, at] of Object.entries(content ?? {})) this.move(joint, at);
        if (this.robot) this.aim();
        break;
      case "frame": if (content) this.place(this.frame(name), content); break;
      case "marker": this.mark(name, content); break;
    }
    this.draw();
  }

  frame(name) {
    if (!this.frames.has(name)) this.frames.set(name, new this.three.Group());
    return this.frames.get(name);
  }

  place(object, { parent, xyz, quaternion }) {
    if (object.urdf) return;
    object.position.set(...xyz);
    object.quaternion.set(...quaternion);
    this.frame(parent).add(object);
  }

  // Builds links and joints of a URDF out of its boxes, cylinders and balls.
  build(text) {
    if (text === this.robot) return;
    this.robot = text;
    const { Group, Vector3 } = this.three, tree = new DOMParser().parseFromString(text, "text/xml");
    for (const link of tree.querySelectorAll("robot > link")) {
      const group = this.frame(link.getAttribute("name"));
      for (const visual of link.querySelectorAll(":scope > visual")) group.add(this.solid(visual));
    }
    for (const joint of tree.querySelectorAll("robot > joint")) {
      const parent = this.frame(joint.querySelector("parent").getAttribute("link"));
      const child = this.frame(joint.querySelector("child").getAttribute("link")), base = new Group();
      this.toOrigin(base, joint.querySelector(":scope > origin"));
      parent.add(base);
      child.position.set(0, 0, 0);
      child.quaternion.identity();
      child.urdf = true;
      base.add(child);
      const axis = new Vector3(...numbers(joint.querySelector("axis")?.getAttribute("xyz") ?? "1 0 0")).normalize();
      const mimic = joint.querySelector("mimic"), leader = mimic?.getAttribute("joint") ?? joint.getAttribute("name");
      const factor = Number(mimic?.getAttribute("multiplier") ?? 1), slides = joint.getAttribute("type") === "prismatic";
      this.joints.set(leader, [...(this.joints.get(leader) ?? []), { child, axis, factor, slides }]);
    }
    this.aimed = false;
  }

  // Has the view take in what moves, where it first was; the floor is larger.
  aim() {
    if (this.aimed) return;
    this.aimed = true;
    this.world.updateMatrixWorld(true);
    const box = new this.three.Box3();
    for (const frame of this.frames.values()) if (frame.urdf) box.expandByObject(frame);
    if (box.isEmpty()) return;
    box.getCenter(this.target);
    this.turn.distance = 1.3 * box.getSize(new this.three.Vector3()).length();
  }

  toOrigin(object, origin) {
    const [roll, pitch, yaw] = numbers(origin?.getAttribute("rpy"));
    object.position.set(...numbers(origin?.getAttribute("xyz")));
    object.rotation.set(roll, pitch, yaw, "ZYX");
  }

  solid(visual) {
    const { BoxGeometry, CylinderGeometry, SphereGeometry, Mesh, Group } = this.three;
    const shape = visual.querySelector("geometry").firstElementChild, of = (name) => Number(shape?.getAttribute(name));
    const geometry = {
      box: () => new BoxGeometry(...numbers(shape.getAttribute("size"))),
      cylinder: () => new CylinderGeometry(of("radius"), of("radius"), of("length"), 24).rotateX(Math.PI / 2),
      sphere: () => new SphereGeometry(of("radius"), 24, 16),
    }[shape?.tagName]?.();
    const color = visual.querySelector("material > color")?.getAttribute("rgba");
    const object = geometry ? new Mesh(geometry, this.material(color ? numbers(color) : [0.7, 0.7, 0.7, 1])) : new Group();
    this.toOrigin(object, visual.querySelector(":scope > origin"));
    return object;
  }

  material([r, g, b, a]) {
    const { MeshStandardMaterial, Color, SRGBColorSpace } = this.three;
    return new MeshStandardMaterial({ color: new Color().setRGB(r, g, b, SRGBColorSpace), roughness: 0.7, opacity: a,
      transparent: a < 1, depthWrite: a === 1 });
  }

  move(name, at) {
    for (const { child, axis, factor, slides } of this.joints.get(name) ?? []) {
      if (slides) child.position.copy(axis).multiplyScalar(factor * at);
      else child.quaternion.setFromAxisAngle(axis, factor * at);
    }
  }

  mark(name, marker) {
    this.shown.get(name)?.removeFromParent().traverse(dispose);
    this.shown.delete(name);
    if (!marker || HIDDEN.test(name)) return;
    const three = this.three, { kind, color, scale, points } = marker;
    let object;
    const drawn = () => new three.BufferGeometry().setFromPoints(points.map((point) => new three.Vector3(...point)));
    if (kind === "strip" || kind === "list") {
      const geometry = drawn();
      const { color: tint } = this.material(color), line = new three.LineBasicMaterial({ color: tint });
      object = new (kind === "strip" ? three.Line : three.LineSegments)(geometry, line);
    } else {
      const geometry = { faces: () => { const faces = drawn(); faces.computeVertexNormals(); return faces; }, cube: () => new three.BoxGeometry(), sphere: () => new three.SphereGeometry(0.5, 20, 14),
        cylinder: () => new three.CylinderGeometry(0.5, 0.5, 1, 24).rotateX(Math.PI / 2) }[kind]();
      object = new three.Mesh(geometry, this.material(color));
      object.scale.set(...scale);
    }
    this.place(object, { ...marker, parent: marker.frame });
    this.shown.set(name, object);
  }

  show(camera, kind, content) {
    if (!this.images.has(camera)) {
      const figure = document.createElement("figure"), image = document.createElement("img");
      const spot = Object.assign(document.createElement("i"), { className: "spot", hidden: true });
      image.alt = `last image of camera ${camera}`;
      const caption = document.createElement("figcaption");
      figure.append(image, spot, caption);
      this.images.set(camera, { image, spot, caption, at: null, residuals: "" });
      this.cameras.append(figure);
    }
    const entry = this.images.get(camera);
    if (kind === "image") entry.image.src = content ?? "";
    else if (kind === "spot") entry.at = content;
    else entry.residuals = content;
    entry.caption.textContent = [camera, entry.at && `spot at ${entry.at.map((each) => each.toFixed(1)).join(", ")} px`,
      entry.residuals && `residuals ${entry.residuals}`].filter(Boolean).join("; ");
    const around = () => {
      const { at, image, spot } = entry;
      spot.hidden = !at || !image.naturalWidth;
      if (spot.hidden) return;
      spot.style.left = `${100 * at[0] / image.naturalWidth}%`;
      spot.style.top = `${100 * at[1] * image.clientHeight / image.naturalHeight / image.parentElement.clientHeight}%`;
      spot.title = `spot at ${at[0].toFixed(2)}, ${at[1].toFixed(2)} px`;
    };
    entry.image.onload = around;
    around();
  }

  // Draws once, however much has changed since the last frame.
  draw() {
    if (this.due || !this.three) return;
    this.due = true;
    requestAnimationFrame(() => {
      this.due = false;
      const { azimuth, height, distance } = this.turn, { clientWidth: width, clientHeight: tall } = this.canvas;
      if (!width || !tall) return;
      const flat = Math.cos(height) * distance;
      this.camera.position.set(flat * Math.cos(azimuth), flat * Math.sin(azimuth), Math.sin(height) * distance).add(this.target);
      this.camera.lookAt(this.target);
      this.camera.aspect = width / tall;
      this.camera.updateProjectionMatrix();
      this.renderer.setPixelRatio(devicePixelRatio);
      this.renderer.setSize(width, tall, false);
      this.renderer.render(this.scene, this.camera);
    });
  }

  listen() {
    const { canvas, turn } = this;
    const rotate = (dx, dy) => {
      turn.azimuth -= dx * 0.008;
      turn.height = Math.min(1.5, Math.max(-0.3, turn.height + dy * 0.008));
      this.draw();
    };
    const zoom = (factor) => { turn.distance = Math.min(30, Math.max(0.3, turn.distance * factor)); this.draw(); };
    canvas.addEventListener("pointermove", (event) => { if (event.buttons === 1) rotate(event.movementX, event.movementY); });
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(event.deltaY * 0.0015)); }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const act = { ArrowLeft: () => rotate(-20, 0), ArrowRight: () => rotate(20, 0), ArrowUp: () => rotate(0, 20),
        ArrowDown: () => rotate(0, -20), "+": () => zoom(0.8), "-": () => zoom(1.25) }[event.key];
      if (act) { event.preventDefault(); event.stopPropagation(); act(); }
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }
}

// Says why there is no drawing; the images are there all the same.
export function excuse(error) {
  byId("flat").hidden = false;
  byId("flat").textContent = `The cell cannot be drawn in three dimensions here: ${error.message}`;
}
