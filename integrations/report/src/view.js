// One picture of a volume: scene, camera, and when what is drawn. Drawn only when something has changed.
import { MathUtils, PerspectiveCamera, Scene, Vector3, WebGLRenderer } from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import * as marks from './marks.js';
import { Nodes } from './nodes.js';
import { displayUniforms, Surfaces } from './surfaces.js';

// After so long without a move every pixel is lit by itself, and the nodes around get their spheres.
const REST_MILLISECONDS = 120;
// More pixels than this are lit at half the resolution of the screen.
const MOST_PIXELS = 1.5e6;

export class View {

	constructor( canvas, worker, opened, { origin, mesh, walls, seen, probes, spacing } ) {

		Object.assign( this, { canvas, worker, opened, origin, seen, spacing, read: null, moves: 0 } );
		this.renderer = new WebGLRenderer( { canvas, antialias: false, preserveDrawingBuffer: true } );
		this.camera = new PerspectiveCamera( 50, 1, 0.01, 1000 );
		this.controls = new OrbitControls( this.camera, canvas );
		this.controls.addEventListener( 'change', () => this.moved() );
		this.uniforms = displayUniforms();
		this.scene = new Scene();
		this.surfaces = mesh && new Surfaces( mesh, this.uniforms );
		this.nodes = new Nodes( worker, opened, 0.08 * spacing, this.uniforms );
		const { min, max } = opened.header;
		this.layers = {
			level: this.surfaces?.mesh,
			walls: marks.boxes( walls, origin, 0xff5ea8 ),
			probes: marks.probes( probes, origin, 0.3 * spacing ),
			box: marks.boxes( [ ...min, ...max ], origin, 0x6fa8dc ),
		};
		this.mark = marks.chosenMark( 0.2 * spacing );
		this.scene.add( ...Object.values( this.layers ).filter( Boolean ), this.nodes.spheres, this.nodes.points, this.mark );
		for ( const name of [ 'walls', 'probes', 'box' ] ) this.layers[ name ].visible = false;
		new ResizeObserver( () => this.resize() ).observe( canvas );
		this.resize();

	}

	resize() {

		const [ width, height ] = [ this.canvas.clientWidth || 1, this.canvas.clientHeight || 1 ];
		const ratio = Math.min( devicePixelRatio, 2 );
		this.renderer.setPixelRatio( width * height * ratio * ratio > MOST_PIXELS ? Math.min( 1, ratio ) : ratio );
		this.renderer.setSize( width, height, false );
		this.camera.aspect = width / height;
		this.camera.updateProjectionMatrix();
		this.nodes.pixels = this.canvas.height / Math.tan( MathUtils.degToRad( this.camera.fov / 2 ) );
		this.moved();

	}

	/** Moves the camera; places relative to the origin. */
	look( eye, target ) {

		const far = 20 * Math.max( 1, new Vector3( ...eye ).distanceTo( new Vector3( ...target ) ), ...this.opened.header.max.map( ( x, c ) => x - this.opened.header.min[ c ] ) );
		Object.assign( this.camera, { near: far / 1e5, far } );
		this.camera.updateProjectionMatrix();
		this.camera.position.set( ...eye );
		this.controls.target.set( ...target );
		this.controls.update();
		this.moved();

	}

	/** What the camera sees has changed. */
	moved( isOwn = true ) {

		this.moves ++;
		this.surfaces?.forgetExact();
		this.read = null;
		this.draw();
		clearTimeout( this.timer );
		this.timer = setTimeout( () => this.rest(), REST_MILLISECONDS );
		if ( isOwn ) this.onMoved?.( this );

	}

	/** Takes the camera of another view. */
	follow( { camera, controls } ) {

		this.camera.position.copy( camera.position );
		this.camera.quaternion.copy( camera.quaternion );
		Object.assign( this.camera, { near: camera.near, far: camera.far } );
		this.camera.updateProjectionMatrix();
		this.controls.target.copy( controls.target );
		this.moved( false );

	}

	draw() {

		this.frame ??= requestAnimationFrame( () => {

			this.frame = null;
			this.renderer.setClearColor( this.background ?? 0x20242a, 1 );
			this.renderer.render( this.scene, this.camera );

		} );

	}

	/** The camera rests: light for each pixel, spheres for the nodes around. Resolves when all is drawn. */
	async rest() {

		const { moves } = this;
		const isLate = () => this.moves !== moves;
		await this.nodes.chooseAround( this.camera.position.toArray() );
		if ( isLate() ) return;
		this.draw();
		if ( this.surfaces && this.surfaces.mesh.visible ) {

			const read = await this.surfaces.readPlaces( this.renderer, this.scene, this.camera, this.canvas.width, this.canvas.height );
			if ( isLate() ) return;
			const light = await this.light( read );
			if ( isLate() ) return;
			this.surfaces.setExact( read, light );
			Object.assign( this, { read, exact: light } );
			this.draw();

		}

		this.rested = moves;
		requestAnimationFrame( () => this.onRest?.( this ) );

	}

	light( { positions, normals } ) {

		return this.worker( 'light', { index: this.opened.index, other: this.other, positions, normals, figure: this.mode?.key } );

	}

	/** Shows light or a figure. `scale`: { from, to } of its colours. */
	async show( mode, scale, gain ) {

		this.mode = mode;
		this.uniforms.mode.value = mode.light ? ( mode.id === 'white' ? 1 : 0 ) : 2;
		this.uniforms.scale.value = [ scale.from, scale.to ];
		this.uniforms.gain.value = gain;
		this.nodes.showFigure( mode.key );
		if ( this.layers.seen ) this.scene.remove( this.layers.seen );
		this.layers.seen = null;
		if ( mode.id === 'seen' ) this.scene.add( this.layers.seen = marks.seenPlaces( this.seen, this.origin, 0.2 * this.spacing, scale ) );
		this.showNodes( this.wantsNodes );
		if ( this.surfaces && ( ! mode.light || ! this.isLit ) ) {

			const light = await this.light( this.surfaces.arrays );
			if ( this.mode !== mode ) return;
			this.surfaces.setLight( light );
			this.isLit = true;

		}

		this.moved( false );

	}

	setGain( gain ) {

		this.uniforms.gain.value = gain;
		this.draw();

	}

	/** Nodes have no error between nodes, and no difference of their own: then they are not shown. */
	showNodes( wants ) {

		this.wantsNodes = wants;
		this.nodes.visible = wants && ! [ 'seen', 'difference' ].includes( this.mode?.id );
		this.draw();

	}

	showLayer( name, does ) {

		if ( ! this.layers[ name ] ) return;
		this.layers[ name ].visible = does;
		this.moved( false );

	}

	seeThroughBacks( does ) {

		this.surfaces?.seeThroughBacks( does );
		this.moved( false );

	}

	/** Frames a place, or nothing. */
	choose( place ) {

		this.mark.visible = Boolean( place );
		if ( place ) this.mark.position.set( ...place );
		this.draw();

	}

	/** The place that a pixel of the canvas shows, from the upper left corner; null where it shows none, or the camera moves. */
	placeAt( x, y ) {

		const { read, canvas } = this;
		if ( ! read ) return null;
		const column = Math.floor( x / canvas.clientWidth * read.width );
		const pixel = column + read.width * ( read.height - 1 - Math.floor( y / canvas.clientHeight * read.height ) );
		if ( read.all[ 4 * pixel + 3 ] !== 1 ) return null;
		const texels = this.surfaces.uniforms.exact.value.image.data.subarray( 4 * pixel, 4 * pixel + 4 );
		return {
			position: [ 0, 1, 2 ].map( ( c ) => read.all[ 4 * pixel + c ] + this.origin[ c ] ),
			normal: [ 0, 1, 2 ].map( ( c ) => read.facing[ 4 * pixel + c ] ),
			irradiance: [ ...texels.slice( 0, 3 ) ],
			figure: texels[ 3 ],
		};

	}

	/** The node under a pixel of the canvas, or -1. */
	async nodeAt( x, y ) {

		if ( ! this.nodes.spheres.visible ) return - 1;
		const { canvas, camera } = this;
		const through = new Vector3( 2 * x / canvas.clientWidth - 1, 1 - 2 * y / canvas.clientHeight, 0.5 ).unproject( camera );
		const direction = through.sub( camera.position ).normalize();
		const surface = this.layers.level?.visible ? this.placeAt( x, y ) : null;
		const far = surface ? new Vector3( ...surface.position.map( ( p, c ) => p - this.origin[ c ] ) ).distanceTo( camera.position ) : Infinity;
		return this.worker( 'pick', { index: this.opened.index, from: camera.position.toArray(), direction: direction.toArray(), radius: this.nodes.radius, far } );

	}

	/** Flies by a key; true if it is one. */
	fly( key ) {

		const step = 0.4 * this.spacing;
		const moves = { w: [ 0, 0, - 1 ], s: [ 0, 0, 1 ], a: [ - 1, 0, 0 ], d: [ 1, 0, 0 ], q: [ 0, - 1, 0 ], e: [ 0, 1, 0 ] };
		const turns = { ArrowLeft: [ 1, 0 ], ArrowRight: [ - 1, 0 ], ArrowUp: [ 0, 1 ], ArrowDown: [ 0, - 1 ] };
		const { camera, controls } = this;
		if ( moves[ key ] ) {

			const by = new Vector3( ...moves[ key ] ).multiplyScalar( step ).applyQuaternion( camera.quaternion );
			camera.position.add( by );
			controls.target.add( by );

		} else if ( turns[ key ] ) {

			// Turns the head: the target goes round the camera.
			const to = controls.target.clone().sub( camera.position );
			to.applyAxisAngle( new Vector3( 0, 1, 0 ), 0.08 * turns[ key ][ 0 ] );
			to.applyAxisAngle( new Vector3().crossVectors( to, new Vector3( 0, 1, 0 ) ).normalize(), 0.08 * turns[ key ][ 1 ] );
			controls.target.copy( camera.position ).add( to );

		} else return false;
		controls.update();
		this.moved();
		return true;

	}

}
