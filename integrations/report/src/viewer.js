// The views with their switches: what is shown, how bright, what stands in the scene; and what was clicked.
import { details, DIRECTIONS, surfaceDetails } from './details.js';
import { element } from './elements.js';
import { heat, MODES, roundUp } from './scales.js';
import { View } from './view.js';
import { worstList } from './worst.js';

const LAYERS = [ [ 'level', 'Level', true ], [ 'nodes', 'Nodes', true ], [ 'walls', 'Cells with walls', false ], [ 'probes', 'Probes', false ], [ 'box', 'Box', false ] ];
// The usual exposure shows the median light of nodes, on white, as this share of white.
const GREY = 0.25;

export class Viewer {

	/** `shown`: volumes that the worker opened, with what the file says of each. One view for each, cameras linked. */
	constructor( worker, shown, scene, comparison ) {

		Object.assign( this, { worker, shown, comparison, stops: 0, mode: MODES[ 0 ] } );
		const { opened } = shown[ 0 ];
		this.usual = GREY * Math.PI / ( opened.luminance || 1 );
		this.canvases = shown.map( ( { name } ) => element( 'canvas.view', { tabIndex: 0, 'aria-label': `3-D view of ${ name }`, onkeydown: ( event ) => this.pressed( event ) } ) );
		this.details = element( 'div', { 'aria-live': 'polite' } );
		this.legend = element( 'div.legend' );
		this.modes = element( 'div.modes', { role: 'radiogroup', 'aria-label': 'Show' }, MODES.filter( ( mode ) => mode.id !== 'difference' || comparison ).map( ( mode ) => this.modeSwitch( mode ) ) );
		this.part = element( 'div.viewer', {},
			element( 'div.stage', {}, element( 'div.views', {}, this.canvases.map( ( canvas, k ) => element( 'div', {}, shown.length > 1 && element( 'p.name', {}, shown[ k ].name ), canvas ) ) ), this.legend,
				element( 'p.hint', {}, 'Drag: orbit. Wheel: nearer. Right drag: shift. Keys W A S D Q E fly, arrows look around. Click a node or a surface for its numbers.' ) ),
			element( 'aside', {}, this.modes, this.layerSwitches( scene ), this.exposure(), this.details, worstList( shown[ 0 ].report, comparison, ( ...where ) => this.go( ...where ) ) ) );
		this.scene = scene;

	}

	/** Needs the canvases in the page. */
	async start() {

		this.views = this.shown.map( ( { opened, walls, seen }, k ) => new View( this.canvases[ k ], this.worker, opened, { ...this.scene, walls, seen } ) );
		this.views.forEach( ( view, k ) => {

			view.other = this.shown[ 1 - k ]?.opened.index;
			view.wantsNodes = true;
			view.onMoved = () => this.views.forEach( ( other ) => other !== view && other.follow( view ) );
			let pressed = null;
			view.canvas.addEventListener( 'pointerdown', ( event ) => pressed = [ event.clientX, event.clientY ] );
			view.canvas.addEventListener( 'click', ( event ) => Math.hypot( event.clientX - pressed[ 0 ], event.clientY - pressed[ 1 ] ) < 4 && this.clicked( view, event ) );

		} );
		const { eye, target } = await this.firstCamera();
		this.views[ 0 ].look( eye, target );
		await this.show( MODES[ 0 ] );

	}

	// At a baked node near a corner of the box, toward its middle.
	async firstCamera() {

		const { opened } = this.shown[ 0 ];
		const { min, max } = opened.header;
		const middle = min.map( ( x, k ) => ( x + max[ k ] ) / 2 - this.scene.origin[ k ] );
		const toward = [ 0.8, 0.35, 0.8 ].map( ( share, k ) => middle[ k ] + share * ( max[ k ] - min[ k ] ) / 2 );
		const best = await this.worker( 'near', { index: opened.index, place: toward } );
		// Beside the node, so that it does not fill the picture.
		const eye = best.map( ( x, k ) => x + 0.3 * this.scene.spacing * ( k === 1 ? 1 : - 0.5 ) );
		return Math.hypot( ...eye.map( ( x, k ) => x - middle[ k ] ) ) > 1e-6 ? { eye, target: middle } : { eye: middle.map( ( x ) => x + 1 ), target: middle };

	}

	modeSwitch( mode ) {

		const has = this.has( mode );
		const input = element( 'input', { type: 'radio', name: 'mode', value: mode.id, checked: mode === MODES[ 0 ], disabled: ! has, onchange: () => this.show( mode ) } );
		return element( 'label', { title: has ? mode.about : `This file says nothing of it: ${ mode.about }` }, input, ` ${ mode.name }` );

	}

	has( mode ) {

		return mode.light || mode.id === 'difference' || this.shown.some( ( { opened, seen } ) => mode.id === 'seen' ? seen.length : opened.figures.includes( mode.key ) );

	}

	layerSwitches( scene ) {

		const { walls } = this.shown[ 0 ];
		const missing = { level: ! scene.mesh && 'name the level too: gdibl inspect FILE LEVEL -o …', walls: ! walls.length && 'no wall stands between nodes', probes: ! scene.probes.some( ( { position } ) => position ) && 'name the BAKE.toml too, to see probes' };
		const boxes = LAYERS.map( ( [ id, name, isOn ] ) => element( 'label', { title: missing[ id ] || '' },
			element( 'input', { type: 'checkbox', name: id, checked: isOn && ! missing[ id ], disabled: Boolean( missing[ id ] ), onchange: ( event ) => this.showLayer( id, event.target.checked ) } ), ` ${ name }` ) );
		boxes.push( element( 'label', { title: 'Leave out surfaces that turn their back to the camera' }, element( 'input', { type: 'checkbox', name: 'backs', checked: true, disabled: ! scene.mesh, onchange: ( event ) => this.views.forEach( ( view ) => view.seeThroughBacks( event.target.checked ) ) } ), ' See through backs' ) );
		return element( 'div.layers', {}, boxes );

	}

	exposure() {

		const said = element( 'output', {}, '0.0 stops' );
		const slider = element( 'input', { type: 'range', min: - 6, max: 6, step: 0.1, value: 0, name: 'exposure', oninput: () => {

			this.stops = Number( slider.value );
			said.textContent = `${ this.stops.toFixed( 1 ) } stops`;
			this.views.forEach( ( view ) => view.setGain( this.gain ) );
			this.onLook?.();

		} } );
		return element( 'label.exposure', {}, 'Brightness ', slider, said );

	}

	get gain() {

		return this.usual * 2 ** this.stops;

	}

	showLayer( id, does ) {

		this.views.forEach( ( view ) => id === 'nodes' ? view.showNodes( does ) : view.showLayer( id, does ) );

	}

	/** The scale of a mode's colours: both views share it. */
	async scaleOf( mode ) {

		if ( mode.light ) return { from: 0, to: 1 };
		if ( mode.to !== null ) return { from: mode.from, to: mode.to };
		if ( mode.id === 'difference' ) return { from: 0, to: roundUp( this.comparison.all.per_node.p95 ) };
		const ends = await Promise.all( this.shown.map( ( { opened } ) => this.worker( 'quantile', { index: opened.index, figure: mode.key, share: 0.98 } ) ) );
		return { from: 0, to: roundUp( Math.max( ...ends ) ) };

	}

	/** Shows a mode. Resolves when it is shown, or another one was asked for meanwhile. */
	show( mode ) {

		return this.shows = this.change( mode );

	}

	async change( mode ) {

		this.asked = mode;
		const range = await this.scaleOf( mode );
		if ( this.asked !== mode ) return;
		Object.assign( this, { mode, range } );
		this.modes.querySelector( `[value="${ mode.id }"]` ).checked = true;
		this.drawLegend();
		this.onLook?.();
		await Promise.all( this.views.map( ( view ) => view.show( mode, this.range, this.gain ) ) );

	}

	drawLegend() {

		const { mode, range } = this;
		const steps = Array.from( { length: 11 }, ( _, k ) => `rgb(${ heat( k / 10 ).map( Math.round ).join() })` );
		const bar = element( 'span.bar' );
		bar.style.background = `linear-gradient(to right, ${ steps.join() })`;
		this.legend.replaceChildren( element( 'b', {}, `${ mode.name }: ` ), element( 'span', {}, mode.about ), ...( mode.light ? [] : [ element( 'span.scale', {}, element( 'span', {}, mode.text( range.from ) ), bar, element( 'span', {}, `${ mode.text( range.to ) }${ mode.to === null ? ' and more' : '' }` ) ) ] ) );

	}

	async clicked( view, event ) {

		const box = view.canvas.getBoundingClientRect();
		const at = [ event.clientX - box.left, event.clientY - box.top ];
		const node = await view.nodeAt( ...at );
		const surface = node < 0 ? view.placeAt( ...at ) : null;
		if ( node >= 0 ) return this.chooseNode( node, view );
		this.views.forEach( ( each ) => each.choose( surface && surface.position.map( ( x, k ) => x - this.scene.origin[ k ] ) ) );
		this.details.replaceChildren( ...( surface ? [ surfaceDetails( surface, this.mode ) ] : [] ) );

	}

	async chooseNode( node, view = this.views[ 0 ] ) {

		const found = await this.worker( 'node', { index: view.opened.index, node, normals: DIRECTIONS } );
		this.details.replaceChildren( details( found, this.gain ) );
		this.views.forEach( ( each ) => each.choose( found.position.map( ( x, k ) => x - this.scene.origin[ k ] ) ) );

	}

	/** Flies to a place, shows what is wrong there, and chooses the node. */
	async go( position, modeId, node ) {

		const mode = MODES.find( ( { id } ) => id === modeId );
		if ( mode && mode !== this.mode ) await this.show( mode );
		this.fly( position.map( ( x, k ) => x - this.scene.origin[ k ] ) );
		if ( node === undefined ) this.details.replaceChildren();
		else await this.chooseNode( node );

	}

	/** Looks at a place (relative to the origin) from the side of the volume's middle, three nodes away. */
	fly( place ) {

		const { min, max } = this.shown[ 0 ].opened.header;
		const inward = place.map( ( x, k ) => ( min[ k ] + max[ k ] ) / 2 - this.scene.origin[ k ] - x );
		const length = Math.hypot( ...inward ) || 1;
		// Askew, so that other nodes of the lattice do not stand in line.
		const away = 3 * this.scene.spacing;
		this.views[ 0 ].look( place.map( ( x, k ) => x + ( inward[ k ] / length + [ 0.31, 0.17, 0.23 ][ k ] ) * away ), place );
		this.views.forEach( ( view ) => view.choose( place ) );

	}

	pressed( event ) {

		if ( event.ctrlKey || event.metaKey || event.altKey ) return;
		if ( this.views[ 0 ].fly( event.key.length === 1 ? event.key.toLowerCase() : event.key ) ) event.preventDefault();

	}

}
